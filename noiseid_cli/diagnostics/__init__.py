"""Diagnostics: does a filter agree with its data."""
