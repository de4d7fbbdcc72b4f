"""Where the true states are known: the normalised estimation error squared (Bar-Shalom, Li & Kirubarajan 2001, 5.4)."""

from __future__ import annotations

import numpy as np

from noiseid_cli.filters.ekf import Filtered
from noiseid_cli.filters.sigma_filter import SigmaFiltered
from noiseid_cli.models.recording import Array, Recording


def nees(recording: Recording, filtered: Filtered | SigmaFiltered) -> Array:
    """(N,) e' P^-1 e / nx with e the error of the filtered state; 1 on average for a consistent filter.

    NaN where P is singular: a state that is exactly known has no normalised error.
    """
    assert recording.x_true is not None
    e = recording.x_true - filtered.m_filt
    # Rows of U over their columns' lengths: the decision about a singular P then does not depend on units.
    lengths = np.sqrt(np.sum(filtered.U_filt**2, axis=1))
    pivots = np.diagonal(filtered.U_filt, axis1=1, axis2=2)
    regular = np.all(pivots > 4 * e.shape[1] * np.finfo(float).eps * lengths, axis=1)
    out = np.full(len(e), np.nan)
    if regular.any():
        white = np.linalg.solve(filtered.U_filt[regular].transpose(0, 2, 1), e[regular][:, :, None])[:, :, 0]
        with np.errstate(over="ignore"):  # an error beyond 1e154 standard deviations is infinite
            out[regular] = np.mean(white**2, axis=1)
    return out
