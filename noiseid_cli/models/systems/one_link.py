"""Planar one-link robot with friction, driven by a motor and seen by an encoder and an accelerometer."""

from __future__ import annotations

from typing import Any, ClassVar

import sympy as sp

from noiseid_cli.models.declarations import Parameter, Quantity, Terms
from noiseid_cli.models.equations import Model


class OneLink(Model):
    """Planar one-link robot in the field of gravity; its angle and its angular acceleration are measured.

    The angle counts from hanging. The friction is viscous and Coulomb, with an arc tangent in place of the sign. A
    noise is what one sample time adds to a state: its covariance is per sample, whatever the sample time is.
    """

    name = "one_link"
    citation = (
        "M. H. Riva, M. Wielitzka and T. Ortmaier, Sensitivity-based adaptive SRUKF for state, parameter, and "
        "covariance estimation on mechatronic systems, in: Kalman Filters - Theory for Advanced Applications, "
        "InTechOpen, 2017, sections 3.1 and 4.1. doi:10.5772/intechopen.72470"
    )
    states = (Quantity("q", "rad", "angle of the link"), Quantity("dq", "rad/s", "speed of the link"))
    inputs = (Quantity("tau", "N m", "torque of the motor"),)
    noises = (
        Quantity("v_q", "rad", "noise added to the angle, per sample"),
        Quantity("v_dq", "rad/s", "noise added to the speed, per sample"),
    )
    outputs = (
        Quantity("q", "rad", "angle of the link"),
        Quantity("ddq", "rad/s^2", "acceleration of the link"),
    )
    parameters = (
        Parameter("inverse_inertia", 1 / 5.59e-2, "1/(kg m^2)", "inverse of the inertia J of all that turns", "paper"),
        Parameter("mu_v", 0.05, "N m s/rad", "viscous friction", "paper"),
        Parameter("mu_d", 0.27, "N m", "Coulomb friction", "paper"),
        Parameter("mal2", 0.11, "kg m", "mass times length of the link", "paper"),
        Parameter("k", 10.0, "s/rad", "sharpness of the sign change of the Coulomb friction", "paper"),
        Parameter("g", 9.81, "m/s^2", "gravity", "chosen"),
        Parameter("Ts", 2e-4, "s", "sample time, in which a noise is added once", "paper"),
    )
    sample_time = 2e-4
    sample_time_parameter = "Ts"
    discretisation = "euler"
    latex_names: ClassVar = {
        "inverse_inertia": "J^{-1}",
        "mal2": "(m_a l_2)",
        "dq": r"\dot q",
        "ddq": r"\ddot q",
        "v_dq": r"v_{\dot q}",
        "Ts": "T_s",
    }

    def terms(self, x: Any, u: Any, p: Any) -> Terms:
        t = Terms()
        friction = p.mu_v * x.dq + p.mu_d * sp.atan(p.k * x.dq)
        t.ddq = p.inverse_inertia * (u.tau - friction - p.mal2 * p.g / 2 * sp.sin(x.q))
        return t

    def dynamics(self, x: Any, u: Any, v: Any, p: Any) -> list[Any]:
        return [x.dq + v.v_q / p.Ts, self.terms(x, u, p).ddq + v.v_dq / p.Ts]

    def output(self, x: Any, u: Any, p: Any) -> list[Any]:
        return [x.q, self.terms(x, u, p).ddq]
