"""Observed information: minus the second derivatives of the log-likelihood, by differences of its gradient.

The step is a share of the standard error itself, so that the curvature is that of the region in which the answer may
lie, and not that of the likelihood's finest teeth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from noiseid_cli.estimators.coordinates import Coordinates
from noiseid_cli.estimators.likelihood import Likelihood
from noiseid_cli.estimators.unknowns import ParameterUnknowns, Unknowns
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array, Recording

# First step, and the share of a standard error that a step is after the first look.
FIRST, SHARE = 1e-4, 0.05
# Eigenvalues of the information, scaled to a unit diagonal: below the first a direction is open, and a coordinate with
# more than this share in it; below minus the last the point is no maximum. PLAIN is next to no curvature at all.
OPEN, TOUCHED, UPHILL, PLAIN = 1e-9, 1e-3, 1e-4, 1e-3
# A coordinate that the data determines no better than this has no use for longer steps.
LONGEST = 0.3


@dataclass(frozen=True)
class Information:
    """Information in free coordinates, observed or expected.

    Attributes:
        names: (d,) what each coordinate is.
        at: (d,) the point.
        matrix: (d, d) symmetric; rows of coordinates at which the filter fails are NaN.
        passes: runs of the filter over the data that it took.
    """

    names: tuple[str, ...]
    at: Array
    matrix: Array
    passes: int

    def covariance(self) -> Array:
        """(d, d) inverse; rows of coordinates that the data leave open (no curvature) are NaN."""
        out = np.full_like(self.matrix, np.nan)
        d = np.diag(self.matrix)
        open_ = ~(np.isfinite(d) & (d > 0.0))
        kept = np.flatnonzero(~open_)
        if kept.size == 0:
            return out
        s = 1.0 / np.sqrt(d[kept])
        scaled = self.matrix[np.ix_(kept, kept)] * np.outer(s, s)
        if not np.all(np.isfinite(scaled)):
            return out
        values, vectors = np.linalg.eigh(scaled)
        seen = values > OPEN
        # A coordinate that an open direction moves is open itself.
        known = ~np.any(np.abs(vectors[:, ~seen]) > TOUCHED, axis=1)
        inverse = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T * np.outer(s, s)
        out[np.ix_(kept[known], kept[known])] = inverse[np.ix_(known, known)]
        return out

    def uphill(self) -> Array | None:
        """(d,) a direction in which the log-likelihood curves upward, as at no maximum; None if there is none."""
        d = np.abs(np.diag(self.matrix))
        if not np.all(np.isfinite(self.matrix)) or self.matrix.size == 0:
            return None
        s = 1.0 / np.sqrt(np.maximum(d, PLAIN))
        values, vectors = np.linalg.eigh(self.matrix * np.outer(s, s))
        return vectors[:, 0] * s if values[0] < -UPHILL else None


def observed_information(
    model: CompiledModel,
    recordings: Sequence[Recording],
    noise: NoiseValues,
    unknowns: Unknowns,
    parameters: ParameterUnknowns | None = None,
    at: Sequence[int] = (),
) -> Information:
    """Observed information of all unknowns at given values.

    Args:
        model: the model at the values of its parameters.
        recordings: the tests.
        noise: noise values, at which the information is taken.
        unknowns: what is unknown of them, with its structure.
        parameters: the unknown model parameters, with their bounds; their values are those of ``model``.
        at: (p,) their places in ``model.parameters``.

    Raises:
        EstimationError: the parameters and their places do not fit the model.
        LinAlgError: an unknown covariance is singular, where it has no free coordinates.
    """
    coordinates = Coordinates(unknowns, noise, model, parameters or ParameterUnknowns(), tuple(at))
    likelihood = Likelihood(coordinates, recordings)
    return information_at(likelihood, coordinates.pack(noise, model.parameters[list(at)]))


def marginal_information(
    model: CompiledModel,
    recordings: Sequence[Recording],
    noise: NoiseValues,
    unknowns: Unknowns,
    parameters: ParameterUnknowns | None = None,
    at: Sequence[int] = (),
    steps: Array | None = None,
) -> Array:
    """Observed information of the noise values where the model's parameters are unknown too: I_nn - I_np I_pp^-1 I_pn.

    Args:
        model, recordings, noise, unknowns, parameters, at: as in ``observed_information``.
        steps: (d,) steps of the differences in the coordinates of the noise values; chosen by the curvature if None.

    Returns:
        (d, d) symmetric, in the coordinates of ``Unknowns.pack``.

    Raises:
        LinAlgError: the data do not determine the parameters; hold those.
    """
    coordinates = Coordinates(unknowns, noise, model, parameters or ParameterUnknowns(), tuple(at))
    likelihood = Likelihood(coordinates, recordings)
    z = coordinates.pack(noise, model.parameters[list(at)])
    d = z.size - len(coordinates.parameters)
    given = np.full(z.size, np.nan)
    given[:d] = np.nan if steps is None else steps
    matrix = information_at(likelihood, z, given).matrix
    if d == z.size:
        return matrix
    np.linalg.cholesky(matrix[d:, d:])
    own: Array = matrix[:d, :d] - matrix[:d, d:] @ np.linalg.solve(matrix[d:, d:], matrix[d:, :d])
    return 0.5 * (own + own.T)


def information_at(likelihood: Likelihood, z: Array, steps: Array | None = None) -> Information:
    """Observed information at the point z of a likelihood; ``steps`` (d,) are chosen where they are NaN or None."""
    before = likelihood.passes
    visited = len(likelihood.visited)
    given = np.full(z.size, np.nan) if steps is None else steps
    found = [
        _row(likelihood, z, i) if np.isnan(step) else _difference(likelihood, z, i, float(step))
        for i, step in enumerate(given)
    ]
    rows = np.array(found).reshape(z.size, z.size)
    # Probes are no steps of a search.
    del likelihood.visited[visited:]
    names = likelihood.coordinates.names
    return Information(names, z, 0.5 * (rows + rows.T), likelihood.passes - before)


def _row(likelihood: Likelihood, z: Array, i: int) -> Array:
    """(d,) minus the derivative of the gradient by coordinate i; the step is chosen by the curvature found."""
    step = FIRST
    row = _difference(likelihood, z, i, step)
    curvature = abs(row[i])
    if np.isfinite(curvature):
        better = min(LONGEST, SHARE / np.sqrt(curvature)) if curvature > 0.0 else LONGEST
        if not 0.2 < better / step < 5.0:
            longer = _difference(likelihood, z, i, better)
            row = longer if np.all(np.isfinite(longer)) else row
    return row


def _difference(likelihood: Likelihood, z: Array, i: int, step: float) -> Array:
    e = step * (np.arange(z.size) == i)
    above, below = likelihood.point(z + e), likelihood.point(z - e)
    return (below.gradient - above.gradient) / (2.0 * step)
