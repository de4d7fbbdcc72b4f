"""The exact gradient of the extended Kalman filter's log-likelihood: its reverse derivative, sample by sample.

One backward run, see ``filters.ekf_reverse``, gives the derivatives by every entry of Q, R and P0, by m0 and by every
model parameter, whatever their number, through the linearisation points as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from noiseid_cli.filters.ekf import Filtered
from noiseid_cli.filters.ekf_reverse import run_back
from noiseid_cli.filters.linalg import upper_factor
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.discretisation_adjoint import REVERSIBLE
from noiseid_cli.models.recording import Array, Recording


@dataclass(frozen=True)
class Gradient:
    """Derivatives of one log-likelihood; those by covariances are symmetric, dl = tr(Q dQ).

    Attributes:
        Q: (nv, nv); R: (ny, ny); m0: (nx,) by the mean of the first state; P0: (nx, nx).
        parameters: (np,) by the parameters of the model.
    """

    Q: Array
    R: Array
    m0: Array
    P0: Array
    parameters: Array


def has_exact_gradient(model: CompiledModel) -> bool:
    """The model's equations and its discretisation have adjoints."""
    return model.load_adjoints is not None and model.scheme in REVERSIBLE


def loglik_gradient(model: CompiledModel, recording: Recording, filtered: Filtered, Q: Array) -> Gradient:
    """Gradient of the log-likelihood that ``extended_kalman_filter`` reports for one test.

    Args:
        model: a model with adjoints, see ``has_exact_gradient``.
        recording: the test.
        filtered: the filter's results on it.
        Q: (nv, nv) process noise covariance of that run.
    """
    assert model.load_adjoints is not None
    adjoints = model.load_adjoints()
    nx, nv, ny = model.nx, model.nv, model.ny
    out = Gradient(
        np.zeros((nv, nv)), np.zeros((ny, ny)), np.empty(nx), np.empty((nx, nx)), np.zeros(model.parameters.size)
    )
    f = filtered
    run_back(
        model.scheme, model.drift_jacobian, adjoints.drift, adjoints.output, model.parameters,
        np.ascontiguousarray(recording.dt), np.ascontiguousarray(recording.u), np.ascontiguousarray(Q),
        upper_factor(f.R, "the measurement noise covariance R"),
        f.m_pred, f.U_pred, f.m_filt, f.U_filt, f.F, f.G, f.H, f.innovation,
        out.Q, out.R, out.m0, out.P0, out.parameters,
    )  # fmt: skip
    return out
