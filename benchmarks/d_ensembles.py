"""(d) Likelihood, gradient and information of one test (N 200, m 2, two parameters, Sigma full), and of equal tests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from timing import compared, side_by_side

from noiseid_cli.estimators.cross_sectional.evaluate import full, partitioned
from noiseid_cli.estimators.cross_sectional.problem import Coordinates, CrossSection, Theta
from noiseid_cli.models.parametric import ParametricMatrices
from noiseid_cli.models.recording import Array, Recording

N, NY, NA = 200, 2, 2
SIZES = (2, 6, 12, 20)
TESTS = 1000


def problem(nb: int, tests: int) -> tuple[CrossSection, Theta, Coordinates]:
    """Equal tests of a random stable system whose transition and noise depend on alpha."""
    rng = np.random.default_rng(nb)
    nx = nb + 2
    A, dA = rng.normal(size=(nx, nx)), 0.01 * rng.normal(size=(NA, 1, nx, nx))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    C, Q, R = rng.normal(size=(1, NY, nx)), 0.1 * np.eye(nx)[None], np.eye(NY)[None]
    none = np.zeros((nx, nx))

    def family(alpha: Array, recording: Recording) -> ParametricMatrices:
        return ParametricMatrices(
            A=A[None] + np.einsum("a,atij->tij", alpha, dA), B=np.zeros((1, nx, 0)), Q=(1.0 + alpha[0]) * Q, C=C,
            D=np.zeros((1, NY, 0)), R=R, S_a=none, dA=dA, dB=np.zeros((NA, 1, nx, 0)),
            dQ=np.stack([Q, 0.0 * Q]), dC=np.zeros((NA, *C.shape)), dD=np.zeros((NA, 1, NY, 0)),
            dR=np.zeros((NA, *R.shape)), dS_a=np.zeros((NA, nx, nx)),
        )  # fmt: skip

    blank = Recording("test", np.ones(N - 1), np.zeros((N, 0)), np.empty((N, NY)))
    recordings = tuple(replace(blank, name=f"test-{i}", y=rng.normal(size=(N, NY))) for i in range(tests))
    T = np.eye(nx, nb)
    theta = Theta(np.zeros(nb), np.eye(nb) + 0.1, np.array([0.1, 0.2]))
    return CrossSection.common_map(family, recordings, T), theta, Coordinates(nb, NA, "full", log_alpha=False)


def rows() -> list[list[str]]:
    """Partitioned against full, and shared against single filters."""
    out = []
    for nb in SIZES:
        posed = problem(nb, 1)
        works = {"partitioned": lambda p=posed: partitioned(*p), "full": lambda p=posed: full(*p)}
        out += compared(f"d. ensemble, one test, {nb} unknown starts", side_by_side(works))
    tests, theta, coordinates = problem(2, TESTS)
    works = {
        "one filter for equal tests": lambda: partitioned(tests, theta, coordinates),
        "one filter a test": lambda: [
            partitioned(tests.select(slice(i, i + 1)), theta, coordinates) for i in range(TESTS)
        ],
    }
    return [*out, *compared(f"d. ensemble, {TESTS} equal tests", side_by_side(works, runs=3))]
