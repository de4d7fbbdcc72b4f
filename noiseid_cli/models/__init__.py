"""Models: equations, their compilation, and the recordings they are confronted with."""
