"""The built-in systems, one file each."""
