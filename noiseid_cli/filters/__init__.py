"""Filters and smoothers: arrays in, arrays out."""
