"""Double pendulum of the DFKI underactuated lab, as a model file of a user."""

import sympy as sp

from noiseid_cli.models import Model, Parameter, Quantity, Terms

LAB = "identified by the makers: design A.0, model 2.0"


class DoublePendulum(Model):
    """Double pendulum with a motor at each joint; both joint angles are measured by encoders.

    Angle 1 counts from hanging, angle 2 relative to link 1. The reflected inertia of each rotor, gear^2 Ir, is
    added to the diagonal of the mass matrix. The makers' own model also has small terms, at most gear Ir
    (4.6e-4 kg m^2), for a motor 2 that turns with link 1; they are left out here.
    """

    name = "double_pendulum"
    citation = (
        "F. Wiebe et al., Open source dual-purpose acrobot and pendubot platform, IEEE Robotics & Automation "
        "Magazine, 2023: the system and its identified parameters."
    )
    states = (
        Quantity("q1", "rad", "angle of link 1, from hanging"),
        Quantity("q2", "rad", "angle of link 2, relative to link 1"),
        Quantity("dq1", "rad/s", "speed of angle 1"),
        Quantity("dq2", "rad/s", "speed of angle 2"),
    )
    inputs = (Quantity("tau1", "N m", "torque at joint 1"), Quantity("tau2", "N m", "torque at joint 2"))
    noises = (
        Quantity("v1", "N m", "torque noise at joint 1, per sample"),
        Quantity("v2", "N m", "torque noise at joint 2, per sample"),
    )
    outputs = (Quantity("q1", "rad", "encoder 1"), Quantity("q2", "rad", "encoder 2"))
    parameters = (
        Parameter("m1", 0.5594, "kg", "mass of link 1", source=LAB),
        Parameter("m2", 0.6043, "kg", "mass of link 2", source=LAB),
        Parameter("l1", 0.3, "m", "length of link 1", source=LAB),
        Parameter("r1", 0.3, "m", "distance from joint 1 to the centre of mass of link 1", source=LAB),
        Parameter("r2", 0.18378, "m", "distance from joint 2 to the centre of mass of link 2", source=LAB),
        Parameter("I1", 0.05347, "kg m^2", "inertia of link 1 about joint 1", source=LAB),
        Parameter("I2", 0.02392, "kg m^2", "inertia of link 2 about joint 2", source=LAB),
        Parameter("Ir", 7.66e-5, "kg m^2", "inertia of each rotor", source=LAB),
        Parameter("gear", 6.0, "1", "gear ratio of each motor", source=LAB),
        Parameter("b1", 0.001, "N m s/rad", "viscous damping of joint 1", source=LAB),
        Parameter("b2", 0.001, "N m s/rad", "viscous damping of joint 2", source=LAB),
        Parameter("c1", 0.093, "N m", "Coulomb friction of joint 1", source=LAB),
        Parameter("c2", 0.078, "N m", "Coulomb friction of joint 2", source=LAB),
        Parameter("sharpness", 100.0, "s/rad", "sharpness of the sign change of Coulomb friction", source=LAB),
        Parameter("g", 9.81, "m/s^2", "gravity", source="chosen"),
    )
    sample_time = 0.002
    discretisation = "rk4"

    def terms(self, x, u, p):
        """Mass matrix M, torques of inertia C, gravity G and friction, per joint."""
        t = Terms()
        swing = p.m2 * p.l1 * p.r2
        t.M22 = p.I2 + p.gear**2 * p.Ir
        t.M12 = p.I2 + swing * sp.cos(x.q2)
        t.M11 = p.I1 + p.gear**2 * p.Ir + p.I2 + p.m2 * p.l1**2 + 2 * swing * sp.cos(x.q2)
        t.det = t.M11 * t.M22 - t.M12**2
        t.C1 = -swing * sp.sin(x.q2) * (2 * x.dq1 * x.dq2 + x.dq2**2)
        t.C2 = swing * sp.sin(x.q2) * x.dq1**2
        t.G2 = p.g * p.m2 * p.r2 * sp.sin(x.q1 + x.q2)
        t.G1 = p.g * (p.m1 * p.r1 + p.m2 * p.l1) * sp.sin(x.q1) + t.G2
        t.friction1 = p.b1 * x.dq1 + p.c1 * sp.atan(p.sharpness * x.dq1)
        t.friction2 = p.b2 * x.dq2 + p.c2 * sp.atan(p.sharpness * x.dq2)
        return t

    def dynamics(self, x, u, v, p):
        t = self.terms(x, u, p)
        torque1 = u.tau1 + v.v1 - t.C1 - t.G1 - t.friction1
        torque2 = u.tau2 + v.v2 - t.C2 - t.G2 - t.friction2
        return [
            x.dq1,
            x.dq2,
            (t.M22 * torque1 - t.M12 * torque2) / t.det,
            (t.M11 * torque2 - t.M12 * torque1) / t.det,
        ]

    def output(self, x, u, p):
        return [x.q1, x.q2]
