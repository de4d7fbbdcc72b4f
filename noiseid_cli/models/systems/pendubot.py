"""Pendubot: two links in the field of gravity, of which a motor drives the first only."""

from __future__ import annotations

from typing import Any, ClassVar

import sympy as sp

from noiseid_cli.models.declarations import Parameter, Quantity, Terms
from noiseid_cli.models.equations import Model
from noiseid_cli.models.systems.one_link import OneLink


class Pendubot(Model):
    """Two-link robot whose elbow swings freely; both angles and the acceleration of link 1 are measured.

    Angle 1 counts from the horizontal, so that the robot hangs at -pi/2 rad; angle 2 counts from link 1. The five
    parameters t1 to t5 are the smallest set that the motion depends on. A noise is what one sample time adds to a
    state: its covariance is per sample, whatever the sample time is.
    """

    name = "pendubot"
    citation = OneLink.citation.replace("sections 3.1 and 4.1", "sections 3.2 and 4.2")
    states = (
        Quantity("q1", "rad", "angle of link 1"),
        Quantity("dq1", "rad/s", "speed of link 1"),
        Quantity("q2", "rad", "angle between the links"),
        Quantity("dq2", "rad/s", "speed of that angle"),
    )
    inputs = (Quantity("tau", "N m", "torque of the motor on link 1"),)
    noises = (
        Quantity("v_q1", "rad", "noise added to angle 1, per sample"),
        Quantity("v_dq1", "rad/s", "noise added to speed 1, per sample"),
        Quantity("v_q2", "rad", "noise added to angle 2, per sample"),
        Quantity("v_dq2", "rad/s", "noise added to speed 2, per sample"),
    )
    outputs = (
        Quantity("q1", "rad", "angle of link 1"),
        Quantity("q2", "rad", "angle between the links"),
        Quantity("ddq1", "rad/s^2", "acceleration of link 1"),
    )
    parameters = (
        Parameter("t1", 0.339, "kg m^2", "inertia of link 1, with the mass of link 2 at the elbow", "paper"),
        Parameter("t2", 0.0667, "kg m^2", "inertia of link 2 about the elbow", "paper"),
        Parameter("t3", 0.0812, "kg m^2", "coupling of the links", "paper"),
        Parameter("t4", 0.717, "kg m", "first moment of mass of link 1, with link 2 at the elbow", "paper"),
        Parameter("t5", 0.146, "kg m", "first moment of mass of link 2", "paper"),
        Parameter("mu_v1", 0.09, "N m s/rad", "viscous friction of joint 1", "paper"),
        Parameter("mu_d", 0.226, "N m", "Coulomb friction of joint 1", "paper"),
        Parameter("mu_v2", 0.003, "N m s/rad", "viscous friction of joint 2", "paper"),
        Parameter("k", 10.0, "s/rad", "sharpness of the sign change of the Coulomb friction", "paper"),
        Parameter("g", 9.81, "m/s^2", "gravity", "chosen"),
        Parameter("Ts", 2e-4, "s", "sample time, in which a noise is added once", "paper"),
    )
    sample_time = 2e-4
    sample_time_parameter = "Ts"
    discretisation = "euler"
    latex_names: ClassVar = {
        **{f"t{i}": rf"\vartheta_{i}" for i in range(1, 6)},
        **{f"dq{i}": rf"\dot q_{i}" for i in (1, 2)},
        **{f"ddq{i}": rf"\ddot q_{i}" for i in (1, 2)},
        **{f"v_q{i}": f"v_{{q_{i}}}" for i in (1, 2)},
        **{f"v_dq{i}": rf"v_{{\dot q_{i}}}" for i in (1, 2)},
        "mu_v1": r"\mu_{v1}",
        "mu_v2": r"\mu_{v2}",
        "det_D": r"\det D",
        "Ts": "T_s",
    }

    def terms(self, x: Any, u: Any, p: Any) -> Terms:
        t = Terms()
        cos2, swing = sp.cos(x.q2), p.t3 * sp.sin(x.q2)
        t.D11, t.D12, t.D22 = p.t1 + p.t2 + 2 * p.t3 * cos2, p.t2 + p.t3 * cos2, p.t2
        t.det_D = t.D11 * t.D22 - t.D12**2
        # Torques left for the accelerations: motor and friction less C(q, q') q' less gravity.
        t.G2 = p.g * p.t5 * sp.cos(x.q1 + x.q2)
        t.G1 = p.g * p.t4 * sp.cos(x.q1) + t.G2
        t.C1 = -swing * (2 * x.dq1 * x.dq2 + x.dq2**2)
        t.C2 = swing * x.dq1**2
        t.M1 = u.tau - p.mu_v1 * x.dq1 - p.mu_d * sp.atan(p.k * x.dq1) - t.C1 - t.G1
        t.M2 = -p.mu_v2 * x.dq2 - t.C2 - t.G2
        t.ddq1 = (t.D22 * t.M1 - t.D12 * t.M2) / t.det_D
        t.ddq2 = (t.D11 * t.M2 - t.D12 * t.M1) / t.det_D
        return t

    def dynamics(self, x: Any, u: Any, v: Any, p: Any) -> list[Any]:
        t = self.terms(x, u, p)
        rates = (x.dq1, t.ddq1, x.dq2, t.ddq2)
        return [rate + noise / p.Ts for rate, noise in zip(rates, v, strict=True)]

    def output(self, x: Any, u: Any, p: Any) -> list[Any]:
        return [x.q1, x.q2, self.terms(x, u, p).ddq1]
