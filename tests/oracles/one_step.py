"""One step of a model, called from Python.

``discretisation.transition`` is a part of kernels: called by itself it is compiled anew for every model and in every
run. The kernel of the simulation that holds it is kept on the disk, one for all models.
"""

import numpy as np

from noiseid_cli.models import discretisation
from noiseid_cli.simulation.rollout import advance

workspace = discretisation.workspace.py_func


def transition(scheme, jacobian, x, u, dt, p, x_next, F, G, work):
    """``discretisation.transition`` at v = 0."""
    advance(scheme, jacobian, x, u, np.zeros(G.shape[1]), dt, p, x_next, F, G, work)
