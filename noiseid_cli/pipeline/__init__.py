"""Stages and work units."""
