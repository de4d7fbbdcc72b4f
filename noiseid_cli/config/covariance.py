"""A covariance as it is written in an experiment file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, Self

from pydantic import ConfigDict, Field, model_validator

from noiseid_cli.config.base import Base, Matrix, NotNegatives, refuse

if TYPE_CHECKING:
    from noiseid_cli.models.recording import Array

_FORMS = ("std", "diag", "full")


class Covariance(Base):
    """A symmetric positive semidefinite matrix, in one of three forms: std, diag or full."""

    model_config = ConfigDict(json_schema_extra={"oneOf": [{"required": [form]} for form in _FORMS]})

    std: NotNegatives | None = Field(
        default=None, description="standard deviations, each in the unit of its noise, output or state"
    )
    correlation: Matrix | None = Field(
        default=None,
        description="correlation matrix that goes with std, 1 on its diagonal, no unit; default: no correlation",
    )
    diag: NotNegatives | None = Field(default=None, description="variances, each in the squared unit")
    full: Matrix | None = Field(default=None, description="the whole matrix, row by row, in products of the units")

    @model_validator(mode="after")
    def _check(self) -> Self:
        given = [form for form in _FORMS if getattr(self, form) is not None]
        if len(given) != 1:
            refuse(f"give one of std, diag, full; {_listed(given)}")
        if self.correlation is not None:
            if self.std is None:
                refuse("correlation goes with std", at=["correlation"])
            _check_square(self.correlation, len(self.std), "correlation")
            for i, row in enumerate(self.correlation):
                if row[i] != 1.0:
                    refuse(
                        f"a correlation matrix has 1 on its diagonal, not {row[i]:g}",
                        at=["correlation", i, i],
                    )
            _check_semidefinite(self.correlation, "correlation")
        if self.full is not None:
            _check_square(self.full, len(self.full), "full")
            _check_semidefinite(self.full, "full")
        return self

    @property
    def form(self) -> str:
        """The form that was used: ``std``, ``diag`` or ``full``."""
        return next(form for form in _FORMS if getattr(self, form) is not None)

    @property
    def size(self) -> int:
        """Number of rows."""
        return len(getattr(self, self.form))

    def matrix(self) -> Array:
        """Give the matrix, (n, n)."""
        import numpy as np

        if self.full is not None:
            return np.array(self.full, dtype=np.float64)
        if self.diag is not None:
            return np.diag(np.array(self.diag, dtype=np.float64))
        std = np.array(self.std, dtype=np.float64)
        # s_i s_j before the correlation: the same product on both sides of the diagonal, so exactly symmetric.
        return np.outer(std, std) * (np.eye(len(std)) if self.correlation is None else np.array(self.correlation))


class NoiseCovariance(Covariance):
    """A covariance of the process noise, in one of three forms: std, diag or full; per sample or as a density."""

    unit: Literal["per_sample", "density"] = Field(
        default="per_sample",
        description="per_sample: of the noise that is held over each interval; density: two-sided, std in the unit of "
        "the noise per root hertz, the covariance per sample being density / interval, also where intervals differ",
    )


def _listed(given: list[str]) -> str:
    return f"here are {' and '.join(given)}" if given else "none of them is here"


def _check_square(rows: tuple[tuple[float, ...], ...], size: int, where: str) -> None:
    """Refuse what is not size x size and exactly symmetric."""
    if len(rows) != size:
        refuse(f"has {len(rows)} rows, but must have {size}", at=[where])
    for i, row in enumerate(rows):
        if len(row) != size:
            refuse(f"row {i + 1} has {len(row)} numbers, but must have {size}", at=[where, i])
    for i in range(size):
        for j in range(i):
            if rows[i][j] != rows[j][i]:
                refuse(
                    f"is not symmetric: entry ({i + 1}, {j + 1}) is {rows[i][j]!r}, "
                    f"entry ({j + 1}, {i + 1}) is {rows[j][i]!r}",
                    at=[where, i, j],
                )


def _check_semidefinite(rows: tuple[tuple[float, ...], ...], where: str) -> None:
    """Refuse a matrix with a negative eigenvalue, seen at unit variances so that the units play no part."""
    import numpy as np

    matrix = np.array(rows, dtype=np.float64)
    variances = np.diag(matrix)
    for i in range(len(matrix)):
        if variances[i] < 0.0:
            refuse(f"variance {i + 1} is negative: {variances[i]:g}", at=[where, i, i])
        if variances[i] == 0.0 and matrix[i].any():
            j = int(np.flatnonzero(matrix[i])[0])
            refuse(f"variance {i + 1} is 0, so row {i + 1} must be 0 throughout", at=[where, i, j])
    smallest, direction = smallest_eigenvalue(matrix)
    # The eigenvalue solver rounds by about n eps of the largest eigenvalue, which is at most n here.
    if smallest < -(len(matrix) ** 2) * np.finfo(np.float64).eps:
        refuse(
            f"is not positive semidefinite: scaled to unit variances, its smallest eigenvalue is {smallest:.3g}, "
            f"in the direction {_numbers(direction)}",
            at=[where],
        )


def smallest_eigenvalue(matrix: Array) -> tuple[float, Array]:
    """Smallest eigenvalue and its direction, of the matrix scaled to unit variances.

    The sign of the eigenvalue is that of the matrix itself (Sylvester's law of inertia). Rows of variance
    0 keep their 0.

    Args:
        matrix: (n, n) symmetric, with a diagonal that is not negative.

    Returns:
        The eigenvalue and a unit vector (n,), its largest entry positive.
    """
    import numpy as np

    std = np.sqrt(np.diag(matrix))
    scale = np.where(std > 0.0, std, 1.0)
    values, vectors = np.linalg.eigh(matrix / scale[:, None] / scale[None, :])
    direction = vectors[:, 0]
    return float(values[0]), direction * np.sign(direction[np.argmax(np.abs(direction))])


def _numbers(vector: Any) -> str:
    return "(" + ", ".join(f"{v + 0.0:.3g}" for v in vector) + ")"
