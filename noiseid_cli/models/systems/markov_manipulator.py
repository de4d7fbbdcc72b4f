"""Manipulator along one axis, pushed by a first-order Markov process."""

from __future__ import annotations

from typing import Any, ClassVar

import sympy as sp

from noiseid_cli.models.declarations import Parameter, Quantity
from noiseid_cli.models.equations import Model


class MarkovManipulator(Model):
    """Manipulator along one axis under acceleration control, pushed by a first-order Markov process.

    The push is stationary from the start: its first value has the variance q / (2 rate). Position is measured, for the
    first time one interval after the start. The noise w is white with a spectral density of 1.
    """

    name = "markov_manipulator"
    citation = (
        "D. W. Porter, M. D. Shuster, B. P. Gibbs, W. S. Levine: A partitioned recursive algorithm for the estimation "
        "of dynamical and initial-condition parameters from cross-sectional data, IEEE CDC, 1983, section 5. The "
        "spectral density q is lost in print; the one here is chosen."
    )
    states = (
        Quantity("x1", "m", "position"),
        Quantity("x2", "m/s", "speed"),
        Quantity("x3", "m/s^2", "push of the Markov process, as an acceleration"),
    )
    inputs = (Quantity("command", "m/s^2", "commanded acceleration"),)
    noises = (Quantity("w", "1", "white noise of unit spectral density"),)
    outputs = (Quantity("z", "m", "measured position"),)
    parameters = (
        Parameter("q", 0.02, "m^2/s^5", "spectral density of what drives the Markov process", source="chosen"),
        Parameter("rate", 0.05, "1/s", "1/tau, inverse time constant of the Markov process", source="paper"),
    )
    sample_time = 1.0
    discretisation = "van_loan"
    latex_names: ClassVar[dict[str, str]] = {"command": r"\lambda"}

    def dynamics(self, x: Any, u: Any, v: Any, p: Any) -> Any:
        return [x.x2, u.command + x.x3, -p.rate * x.x3 + sp.sqrt(p.q) * v.w]

    def output(self, x: Any, u: Any, p: Any) -> Any:
        return [x.x1]

    def initial_covariance(self, p: Any) -> Any:
        return sp.diag(0, 0, p.q / (2 * p.rate))
