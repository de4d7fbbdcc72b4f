"""How continuous equations become a step: the schemes and their numbers, which kernels know them by."""

DISCRETE = 0  # the equations give the next state themselves
EULER = 1
RK4 = 2
EXACT = 3  # for equations that are linear in states and noises
# The step of a model driven by white noise is exact too; its noise is that of ``linear_family``, not of a held v.
SCHEMES = {"discrete": DISCRETE, "euler": EULER, "rk4": RK4, "exact": EXACT, "van_loan": EXACT}

DENSITY = 16
"""Added to a scheme: the covariance of v is a density, that of the held noise is v's divided by dt."""
