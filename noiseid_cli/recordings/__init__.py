"""Measured recordings: reading log files and turning them into datasets."""
