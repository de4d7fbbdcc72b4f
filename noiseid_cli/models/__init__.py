"""Models: equations, their compilation, and the recordings they are confronted with."""

from noiseid_cli.models.declarations import Parameter, Quantity, Terms
from noiseid_cli.models.equations import Model

__all__ = ["Model", "Parameter", "Quantity", "Terms"]
