"""Dataset and result files."""
