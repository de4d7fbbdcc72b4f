"""Experiment files: YAML with places, the schema, overrides."""
