"""What is unknown about a problem, as one vector of free coordinates."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.em_statistics import Statistics
from noiseid_cli.estimators.structure import CovarianceStructure
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array

# A standard deviation below this share of its start has gone to zero, which EM never leaves.
GONE = 1e-10


@dataclass(frozen=True)
class ParameterUnknowns:
    """The model's parameters that are estimated.

    Attributes:
        names: as the model declares them.
        start: (p,) where the estimation starts.
        lower, upper: (p,) bounds; -inf and inf where there are none.
    """

    names: tuple[str, ...] = ()
    start: Array = field(default_factory=lambda: np.empty(0))
    lower: Array = field(default_factory=lambda: np.empty(0))
    upper: Array = field(default_factory=lambda: np.empty(0))

    def __len__(self) -> int:
        """Number of them."""
        return len(self.names)


@dataclass(frozen=True)
class Unknowns:
    """The parts of the noise values that are estimated; what is None (or False) is known.

    Attributes:
        Q, R, P0: structure of each unknown covariance.
        m0: the mean of the first state is unknown, and the same for all tests.
    """

    Q: CovarianceStructure | None = None
    R: CovarianceStructure | None = None
    P0: CovarianceStructure | None = None
    m0: bool = False

    def check(self, start: NoiseValues) -> None:
        """Refuse problems that have no answer.

        Raises:
            EstimationError: nothing is unknown, a start is singular, or the tests are too few for P0.
        """
        if not (self.Q or self.R or self.P0 or self.m0):
            raise EstimationError("nothing is unknown: name at least one of process_noise and measurement_noise")
        for structure in (self.Q, self.R, self.P0):
            if structure is not None:
                structure.check()
        tests = len(start.m0)
        if self.P0 is not None and tests < 2:
            raise EstimationError(
                f"the initial covariance cannot be estimated from {tests} test: it would shrink to zero around that "
                "test's own first state; give it as known, or add tests"
            )

    def maximise(self, statistics: Statistics, noise: NoiseValues) -> NoiseValues:
        """All M-steps: the noise values that maximise the expected complete-data log-likelihood."""
        Q, R, m0, P0 = noise.Q, noise.R, noise.m0, noise.P0
        if self.Q is not None:
            Q = self.Q.maximise(statistics.moment_v, Q)
        if self.R is not None:
            S = statistics.moment_e
            unseen = statistics.samples == 0
            S[unseen], S[:, unseen] = R[unseen], R[:, unseen]
            R = self.R.maximise(S, R)
        if self.m0:
            m0 = np.tile(statistics.m_first.mean(axis=0), (len(m0), 1))
        if self.P0 is not None:
            d = statistics.m_first - m0
            second = statistics.U_first.transpose(0, 2, 1) @ statistics.U_first
            P0 = self.P0.maximise(np.mean(second + d[:, :, None] * d[:, None, :], axis=0), P0)
        return NoiseValues(Q, R, m0, P0)

    def covariances(self, *noises: NoiseValues) -> Iterator[tuple[str, CovarianceStructure, tuple[Array, ...]]]:
        """Name, structure and values of each unknown covariance."""
        for name, structure in (("Q", self.Q), ("R", self.R), ("P0", self.P0)):
            if structure is not None:
                yield name, structure, tuple(getattr(noise, name) for noise in noises)

    def mean_scale(self, noise: NoiseValues) -> Array:
        """(nx,) unit in which the initial mean is a free coordinate."""
        return _scale(noise.P0 if self.P0 is None else self.P0.start)

    def pack(self, noise: NoiseValues) -> Array:
        """Free coordinates of the noise values, see ``CovarianceStructure.coordinates``; means in units of sqrt P0."""
        parts = [structure.coordinates(value) for _, structure, (value,) in self.covariances(noise)]
        if self.m0:
            parts.append(noise.m0[0] / self.mean_scale(noise))
        return np.concatenate(parts)

    def unpack(self, z: Array, like: NoiseValues) -> NoiseValues:
        """The noise values at coordinates z; known parts are taken from ``like``."""
        at = 0
        out = like
        for name, structure, (value,) in self.covariances(like):
            size = len(structure.coordinates(value))
            out = replace(out, **{name: structure.covariance(z[at : at + size])})
            at += size
        if self.m0:
            out = replace(out, m0=np.tile(z[at:] * self.mean_scale(like), (len(like.m0), 1)))
        return out

    def gone(self, noise: NoiseValues) -> str:
        """Name of a covariance of which a standard deviation has fallen below ``GONE`` of its start; empty if none."""
        for _, structure, (value,) in self.covariances(noise):
            if np.any(np.sqrt(np.diag(value)) < GONE * np.sqrt(np.diag(structure.start))):
                return structure.what
        return ""

    def change(self, old: NoiseValues, new: NoiseValues) -> float:
        """Largest change of a log standard deviation, a correlation, or an initial mean in units of sqrt P0."""
        out = 0.0
        for _, _, (a, b) in self.covariances(old, new):
            sa, sb = np.sqrt(np.diag(a)), np.sqrt(np.diag(b))
            with np.errstate(divide="ignore", invalid="ignore"):
                steps = [np.abs(np.log(sb / sa)), np.abs(b / np.outer(sb, sb) - a / np.outer(sa, sa)).ravel()]
            out = max(out, *(float(np.max(np.nan_to_num(s, nan=0.0, posinf=np.inf), initial=0.0)) for s in steps))
        if self.m0:
            out = max(out, float(np.max(np.abs(new.m0[0] - old.m0[0]) / _scale(old.P0))))
        return out


def _scale(P0: Array) -> Array:
    """Standard deviations of the first state, 1 where it is exactly known."""
    s = np.sqrt(np.diag(P0))
    return np.where(s > 0.0, s, 1.0)
