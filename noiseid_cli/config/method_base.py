"""What the options of every estimation method have in common."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from noiseid_cli.config.base import Base

KINDS = {
    "Q": "process_noise",
    "R": "measurement_noise",
    "m0": "initial_mean",
    "P0": "initial_covariance",
    "parameters": "parameters",
}
"""Every kind of unknown, with its place in the ``estimate`` section."""

STRUCTURES = ("full", "diagonal", "blocks", "scale", "fixed", "tied")
"""Every structure of an unknown covariance."""


class MethodOptions(Base):
    """What every method has: its name. A subclass gives ``method`` its one value.

    Attributes:
        summary: one line for ``noiseid methods``.
        estimates: which unknowns it can estimate.
        citation: the paper it is from.
        has_score: its end maximises the log-likelihood of its filter, whose curvature there gives standard errors.
        can: the kinds of unknown that it can estimate, of ``KINDS``.
        structures: the structures of the process noise's covariance that it takes, of ``STRUCTURES``.
    """

    summary: ClassVar[str] = ""
    estimates: ClassVar[str] = ""
    citation: ClassVar[str] = ""
    has_score: ClassVar[bool] = False
    can: ClassVar[frozenset[str]] = frozenset()
    structures: ClassVar[frozenset[str]] = frozenset(STRUCTURES)

    method: str = Field(description="the method; default: the label it stands under")
    structure: Literal["full", "diagonal", "scale"] | None = Field(
        default=None, description="structure of the process noise for this method; default: that of process_noise"
    )
