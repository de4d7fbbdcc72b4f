"""What the recursion carries from test to test, as plain arrays that can be written and read back."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np

from noiseid_cli.errors import DataError, EstimationError
from noiseid_cli.estimators.cross_sectional.correlated import Carried
from noiseid_cli.estimators.cross_sectional.problem import Coordinates, Theta
from noiseid_cli.estimators.cross_sectional.scoring import solve_positive
from noiseid_cli.models.recording import Array

Scheme = Literal["literal", "refresh", "statistics"]
STATE_FORMAT = 1


@dataclass(frozen=True)
class RecursiveOptions:
    """Options of ``recursive_ml``.

    Attributes:
        scheme: ``literal`` is the paper's (13), (14); ``refresh`` and ``statistics`` are more efficient in Sigma.
        first: n0, tests of the batch start (the paper: 5; fewer often start at Sigma = 0).
        gain_exponent: gamma(i) = i^-gain_exponent, above 1/2 and at most 1 (the paper's).
        delta: of (14), as a share of the diagonal of R(n0); at most 1e-6, since more biases the answer.
    """

    scheme: Scheme = "statistics"
    first: int = 5
    gain_exponent: float = 1.0
    delta: float = 0.0

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            EstimationError: an option is out of its range.
        """
        if self.scheme not in ("literal", "refresh", "statistics"):
            raise EstimationError(f"scheme {self.scheme!r} is not known; there are literal, refresh and statistics")
        if not 0.5 < self.gain_exponent <= 1.0:
            raise EstimationError(f"gain_exponent must be above 0.5 and at most 1, got {self.gain_exponent}")
        if not 0.0 <= self.delta <= 1e-6:
            raise EstimationError(f"delta must be between 0 and 1e-6, got {self.delta}")


@dataclass(frozen=True)
class RecursiveState:
    """The recursion after ``count`` tests.

    Attributes:
        options, coordinates: how it runs, and what vectors mean.
        vector: (p,) theta in the coordinates.
        information: (p, p) R without its delta part, per test; metric: (p,) diagonal of R(n0).
        delta_share: weight that delta has in R by now.
        count: tests taken in, those of the start included.
        squared_weights: sum of the squares of the tests' weights; 1/count for gamma = 1/i.
        carried: the common bias before the next test, of size zero where tests are independent.
        J, j, weights: (kept, nb, nb), (kept, nb), (kept,) kept statistics; none in the literal scheme.
        history, history_errors: (steps + 1, p) vector after each test from the start on, and the standard errors.
        projected_tests, projected_from: (projections,), (projections, p) at which test a step left Sigma >= 0 and
            where it had led.
        boundary_start: Sigma was singular at the start.
    """

    options: RecursiveOptions
    coordinates: Coordinates
    vector: Array
    information: Array
    metric: Array
    delta_share: float
    count: int
    squared_weights: float
    carried: Carried
    J: Array
    j: Array
    weights: Array
    history: Array
    history_errors: Array
    projected_tests: np.ndarray[Any, np.dtype[np.int64]]
    projected_from: Array
    boundary_start: bool

    @property
    def theta(self) -> Theta:
        """The estimate."""
        return self.coordinates.unpack(self.vector)

    @property
    def standard_errors(self) -> Array:
        """(p,) of mu, the free entries of Sigma, alpha, in their own units, from R without delta."""
        covariance = solve_positive(self.information, np.eye(self.coordinates.size)) * self.squared_weights
        return np.asarray(np.sqrt(np.diag(covariance)) * self.coordinates.slopes(self.theta))

    @property
    def safeguards(self) -> tuple[str, ...]:
        """What acted or warrants care, in sentences."""
        out = []
        if self.boundary_start:
            out.append(
                f"the batch start of {self.options.first} tests has a singular Sigma; the recursion leaves it slowly: "
                "start from more tests"
            )
        if len(self.projected_tests):
            tests = ", ".join(str(i) for i in self.projected_tests)
            out.append(f"Sigma left the set Sigma >= 0 and was projected back at test {tests}")
        return tuple(out)

    def arrays(self) -> dict[str, np.ndarray[Any, Any]]:
        """Everything as arrays; ``from_arrays`` gives the same state to the last bit."""
        out: dict[str, np.ndarray[Any, Any]] = {"format": np.array(STATE_FORMAT)}
        for part in (self.options, self.coordinates):
            out |= {f.name: np.array(getattr(part, f.name)) for f in fields(part)}
        out |= {f"carried_{f.name}": np.array(getattr(self.carried, f.name)) for f in fields(Carried)}
        return out | {name: np.array(getattr(self, name)) for name in _own()}

    @classmethod
    def from_arrays(cls, arrays: dict[str, np.ndarray[Any, Any]]) -> RecursiveState:
        """A state from its arrays.

        Raises:
            DataError: another format, or an array is missing.
        """
        names = [*_own(), *(f.name for part in (RecursiveOptions, Coordinates) for f in fields(part))]
        bias = [f"carried_{f.name}" for f in fields(Carried)]
        missing = sorted({"format", *names, *bias} - set(arrays))
        if missing:
            raise DataError(f"the state of the recursion lacks {', '.join(missing)}")
        if int(arrays["format"]) != STATE_FORMAT:
            raise DataError(f"the state of the recursion has format {int(arrays['format'])}, expected {STATE_FORMAT}")
        values: dict[str, Any] = {n: arrays[n].item() if arrays[n].ndim == 0 else arrays[n] for n in names}
        return cls(
            options=RecursiveOptions(**{f.name: values[f.name] for f in fields(RecursiveOptions)}),
            coordinates=Coordinates(**{f.name: values[f.name] for f in fields(Coordinates)}),
            carried=Carried(*(arrays[name] for name in bias)),
            **{name: values[name] for name in _own()},
        )


def _own() -> list[str]:
    """Fields of the state that are arrays or numbers."""
    return [f.name for f in fields(RecursiveState) if f.name not in ("options", "coordinates", "carried")]
