"""Two-axis flexible industrial robot with nonlinear springs, friction and an accelerometer at the tool."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import sympy as sp

from noiseid_cli.models.declarations import Parameter, Quantity, Terms
from noiseid_cli.models.equations import Model

PSI = 2 / 60 * math.pi / 180  # 2 arcmin

# name, joint 1, joint 2, unit, description
_PER_JOINT = (
    ("m", 100.0, 150.0, "kg", "mass of arm"),
    ("l", 0.9, 1.0, "m", "length of arm"),
    ("xi", 0.45, 0.45, "m", "distance to the centre of mass of arm"),
    ("j", 10.0, 20.0, "kg m^2", "inertia about the centre of mass of arm"),
    ("jm", 130.0, 60.0, "kg m^2", "inertia of motor"),
    ("k_low", 3e5, 1e5, "N m/rad", "stiffness at zero deflection of spring"),
    ("k_high", 1e6, 4e5, "N m/rad", "stiffness beyond psi of spring"),
    ("psi", PSI, PSI, "rad", "deflection where the stiffness becomes constant, spring"),
    ("d", 1000.0, 400.0, "N m s/rad", "damping of spring"),
    ("f_d", 120.0, 60.0, "N m s/rad", "viscous friction of motor"),
    ("f_c", 100.0, 50.0, "N m", "Coulomb friction of motor"),
    ("mu_k", 0.5, 0.5, "1", "kinetic share of the Coulomb friction of motor"),
    ("alpha", 20.0, 20.0, "s/rad", "sharpness of the sign change of the friction of motor"),
    ("beta", 20.0, 20.0, "s/rad", "decay of the static friction of motor"),
)


class FlexibleRobot(Model):
    """Two-axis industrial robot arm with elastic joints; motor angles and tool acceleration are measured.

    Arm 1 points up and arm 2 forward at zero arm angles. Motor quantities stand on the arm side of the
    gearbox. The poster gives the structure and names the components, but prints neither their equations nor
    any number: the equations are the ones usual for this robot family and every number is chosen.
    """

    name = "flexible_robot"
    citation = (
        "P. Axelsson, U. Orguner, F. Gustafsson and M. Norrlöf, ML estimation of process noise variance in "
        "dynamic systems (poster, 2011): structure of the model. Its physical numbers are not printed; those "
        "here are chosen."
    )
    states = (
        Quantity("qa1", "rad", "arm angle 1"),
        Quantity("qa2", "rad", "arm angle 2"),
        Quantity("qm1", "rad", "motor angle 1"),
        Quantity("qm2", "rad", "motor angle 2"),
        Quantity("dqa1", "rad/s", "arm speed 1"),
        Quantity("dqa2", "rad/s", "arm speed 2"),
        Quantity("dqm1", "rad/s", "motor speed 1"),
        Quantity("dqm2", "rad/s", "motor speed 2"),
    )
    inputs = (Quantity("u1", "N m", "torque of motor 1"), Quantity("u2", "N m", "torque of motor 2"))
    noises = (
        Quantity("va1", "N m", "torque noise on arm 1, per sample"),
        Quantity("va2", "N m", "torque noise on arm 2, per sample"),
        Quantity("vm1", "N m", "torque noise on motor 1, per sample"),
        Quantity("vm2", "N m", "torque noise on motor 2, per sample"),
    )
    outputs = (
        Quantity("qm1", "rad", "motor angle 1"),
        Quantity("qm2", "rad", "motor angle 2"),
        Quantity("acc_s", "m/s^2", "tool acceleration along arm 2, gravity included"),
        Quantity("acc_n", "m/s^2", "tool acceleration across arm 2, gravity included"),
    )
    performances = (
        Quantity("px", "m", "tool position, forward"),
        Quantity("py", "m", "tool position, up"),
    )
    parameters = (
        *(
            Parameter(f"{name}{joint}", value, unit, f"{text} {joint}", source="chosen")
            for name, first, second, unit, text in _PER_JOINT
            for joint, value in ((1, first), (2, second))
        ),
        Parameter("g", 9.81, "m/s^2", "gravity", source="chosen"),
    )
    sample_time = 5e-4
    discretisation = "euler"
    latex_names: ClassVar = {
        **{f"q{part}{i}": f"q_{{{part}{i}}}" for part in "am" for i in (1, 2)},
        **{f"dq{part}{i}": rf"\dot q_{{{part}{i}}}" for part in "am" for i in (1, 2)},
        **{f"v{part}{i}": f"v_{{{part}{i}}}" for part in "am" for i in (1, 2)},
        **{f"ddqa{i}": rf"\bar{{\ddot q}}_{{a{i}}}" for i in (1, 2)},
        **{f"k_low{i}": rf"k_{{\mathrm{{low}},{i}}}" for i in (1, 2)},
        **{f"k_high{i}": rf"k_{{\mathrm{{high}},{i}}}" for i in (1, 2)},
        **{f"tau_s{i}": rf"\tau_{{s{i}}}" for i in (1, 2)},
        **{f"jm{i}": f"j_{{m{i}}}" for i in (1, 2)},
        **{f"k3_{i}": f"k_{{3,{i}}}" for i in (1, 2)},
        **{f"m0_{i}": f"m_{{0,{i}}}" for i in (1, 2)},
        "det_J": r"\det J",
        "ax": "a_x",
        "ay": "a_y",
        "acc_s": "a_s",
        "acc_n": "a_n",
        "px": "p_x",
        "py": "p_y",
    }

    def terms(self, x: Any, u: Any, p: Any) -> Terms:
        t = Terms()
        # Inertia Ma of the arms, Coriolis and centrifugal torques C, gravity torques G.
        t.s = x.qa1 + x.qa2
        lever = p.l1 * p.xi2 * sp.sin(x.qa2)
        t.J11 = p.j1 + p.m1 * p.xi1**2 + p.j2 + p.m2 * (p.l1**2 + p.xi2**2 - 2 * lever)
        t.J12 = p.j2 + p.m2 * (p.xi2**2 - lever)
        t.J22 = p.j2 + p.m2 * p.xi2**2
        t.det_J = t.J11 * t.J22 - t.J12**2
        swing = p.m2 * p.l1 * p.xi2 * sp.cos(x.qa2)
        t.C1 = -swing * (2 * x.dqa1 * x.dqa2 + x.dqa2**2)
        t.C2 = swing * x.dqa1**2
        t.G1 = -p.g * (p.m1 * p.xi1 * sp.sin(x.qa1) + p.m2 * (p.l1 * sp.sin(x.qa1) + p.xi2 * sp.cos(t.s)))
        t.G2 = -p.g * p.m2 * p.xi2 * sp.cos(t.s)
        # Spring torque tau_s, torque A through the gearbox, friction kappa of the motor, for each joint.
        for i in "12":
            k_low, k_high, psi = p[f"k_low{i}"], p[f"k_high{i}"], p[f"psi{i}"]
            t[f"k3_{i}"] = (k_high - k_low) / (3 * psi**2)
            t[f"m0_{i}"] = k_low * psi + t[f"k3_{i}"] * psi**3
            t[f"delta{i}"] = x[f"qa{i}"] - x[f"qm{i}"]
            t[f"tau_s{i}"] = _spring(t[f"delta{i}"], k_low, k_high, psi, t[f"k3_{i}"], t[f"m0_{i}"])
            t[f"A{i}"] = p[f"d{i}"] * (x[f"dqa{i}"] - x[f"dqm{i}"]) + t[f"tau_s{i}"]
            w, mu = x[f"dqm{i}"], p[f"mu_k{i}"]
            stribeck = (mu + (1 - mu) * sp.sech(p[f"beta{i}"] * w)) * sp.tanh(p[f"alpha{i}"] * w)
            t[f"kappa{i}"] = -(p[f"f_d{i}"] * w + p[f"f_c{i}"] * stribeck)
        # Arm accelerations without noise: the accelerometer reads these, so that h depends on x and u only.
        torque1, torque2 = -t.C1 - t.G1 - t.A1, -t.C2 - t.G2 - t.A2
        t.ddqa1 = (t.J22 * torque1 - t.J12 * torque2) / t.det_J
        t.ddqa2 = (t.J11 * torque2 - t.J12 * torque1) / t.det_J
        # Acceleration of the tool, with gravity as an upward acceleration.
        sin1, cos1, rate = sp.sin(x.qa1), sp.cos(x.qa1), x.dqa1 + x.dqa2
        turn = t.ddqa1 + t.ddqa2
        t.ax = p.l1 * (cos1 * t.ddqa1 - sin1 * x.dqa1**2) - p.l2 * (sp.sin(t.s) * turn + sp.cos(t.s) * rate**2)
        arm1, arm2 = sin1 * t.ddqa1 + cos1 * x.dqa1**2, sp.cos(t.s) * turn - sp.sin(t.s) * rate**2
        t.ay = p.g - p.l1 * arm1 - p.l2 * arm2
        return t

    def dynamics(self, x: Any, u: Any, v: Any, p: Any) -> list[Any]:
        t = self.terms(x, u, p)
        return [
            x.dqa1,
            x.dqa2,
            x.dqm1,
            x.dqm2,
            t.ddqa1 + (t.J22 * v.va1 - t.J12 * v.va2) / t.det_J,
            t.ddqa2 + (t.J11 * v.va2 - t.J12 * v.va1) / t.det_J,
            (t.A1 + t.kappa1 + u.u1 + v.vm1) / p.jm1,
            (t.A2 + t.kappa2 + u.u2 + v.vm2) / p.jm2,
        ]

    def output(self, x: Any, u: Any, p: Any) -> list[Any]:
        t = self.terms(x, u, p)
        sin, cos = sp.sin(t.s), sp.cos(t.s)
        return [x.qm1, x.qm2, cos * t.ax - sin * t.ay, sin * t.ax + cos * t.ay]

    def performance(self, x: Any, u: Any, p: Any) -> list[Any]:
        t = self.terms(x, u, p)
        return [
            p.l1 * sp.sin(x.qa1) + p.l2 * sp.cos(t.s),
            p.l1 * sp.cos(x.qa1) - p.l2 * sp.sin(t.s),
        ]


def _spring(delta: Any, k_low: Any, k_high: Any, psi: Any, k3: Any, m0: Any) -> Any:
    """Hardening spring: cubic up to |delta| = psi and linear beyond, with continuous value and slope."""
    return sp.Piecewise(
        (m0 + k_high * (delta - psi), delta > psi),
        (-m0 + k_high * (delta + psi), delta < -psi),
        (k_low * delta + k3 * delta**3, True),
    )
