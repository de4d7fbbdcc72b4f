"""The recursive Gauss-Newton step against its dense formula, the monitor against brute force."""

import numpy as np
import pytest

from noiseid_cli.estimators.excitation import excitation, sliding_maximum
from noiseid_cli.estimators.rpem import adapt
from noiseid_cli.filters.gram_schmidt import width


def dense(theta, Theta, Delta, psi, e, seen, lam, gate):
    """riva2017_sensitivity_asrukf, eq. 7, on matrices, with one gate for each unknown."""
    keep = np.ones(len(Delta))
    keep[seen] = np.sqrt(lam)
    full = np.zeros(len(Delta))
    full[seen] = e
    Delta = keep[:, None] * Delta * keep + (1 - lam) * np.outer(full, full)
    D = Delta[np.ix_(seen, seen)]
    L = Theta @ psi.T @ np.linalg.inv(lam * D + psi @ Theta @ psi.T)
    L[~gate] = 0.0
    scale = np.where(gate, 1 / np.sqrt(lam), 1.0)
    A = np.eye(len(theta)) - L @ psi
    return theta + L @ e, scale[:, None] * (A @ Theta @ A.T) * scale + L @ D @ L.T, Delta


@pytest.mark.parametrize("seed", range(4))
def test_factors_follow_the_dense_formula(seed):
    rng = np.random.default_rng(seed)
    p, ny, lam = 4, 3, 0.97
    UT, UD = (np.triu(rng.normal(size=(k, k))) for k in (p, ny))
    UT[np.diag_indices(p)], UD[np.diag_indices(ny)] = 1.0, 0.5
    theta = rng.normal(size=p)
    Theta, Delta = UT.T @ UT, UD.T @ UD
    twin = theta.copy()
    for k in range(12):
        seen = np.flatnonzero(rng.uniform(size=ny) < 0.7) if k else np.arange(ny)
        q = len(seen)
        gate = rng.uniform(size=p) < 0.7
        psi, e = np.zeros((ny, p)), np.zeros(ny)
        psi[:q], e[:q] = rng.normal(size=(q, p)), rng.normal(size=q)
        observed = np.zeros(ny, dtype=np.int64)
        observed[:q] = seen
        scratch = (np.empty((p, ny)), np.empty((p, ny)), np.empty((ny, ny)), np.empty((p, width(p + ny))), np.empty(ny))
        if q:
            assert adapt(theta, UT, UD, psi, e, observed, q, lam, gate.astype(float), *scratch)
            twin, Theta, Delta = dense(twin, Theta, Delta, psi[:q], e[:q], seen, lam, gate)
        assert theta == pytest.approx(twin, rel=1e-10)
        assert pytest.approx(Theta, rel=1e-10, abs=1e-12) == UT.T @ UT
        assert pytest.approx(Delta, rel=1e-10, abs=1e-12) == UD.T @ UD


def test_a_singular_innovation_covariance_is_reported():
    scratch = (np.empty((1, 1)), np.empty((1, 1)), np.empty((1, 1)), np.empty((1, width(2))), np.empty(1))
    zero = np.zeros((1, 1))
    args = (np.zeros(1), zero.copy(), zero.copy(), np.ones((1, 1)), np.zeros(1), np.zeros(1, dtype=np.int64), 1, 0.9)
    assert not adapt(*args, np.ones(1), *scratch)


@pytest.mark.parametrize("window", [1, 2, 7, 50, 1000, 0])
def test_sliding_maximum_against_brute_force(window):
    rng = np.random.default_rng(window)
    x = np.abs(rng.normal(size=300)).round(1)  # with ties
    x[100:150] = np.linspace(3, 0, 50)  # a long fall fills the deque
    c = min(window, 300) if window else 1
    values, steps, ends = np.zeros(c), np.zeros(c, dtype=np.int64), np.zeros(2, dtype=np.int64)
    for k in range(300):
        begin = max(0, k - window + 1) if window else 0
        assert sliding_maximum(x[k], k, window, values, steps, ends) == x[begin : k + 1].max()


def test_excitation_sums_normalised_sensitivities():
    rng = np.random.default_rng(1)
    S = rng.normal(size=(40, 2, 3))
    S[:, 1, 2] = 0.0  # never excited: counts as nothing
    window = 5
    values, steps = np.zeros((2, 3, window)), np.zeros((2, 3, window), dtype=np.int64)
    ends, out = np.zeros((2, 3, 2), dtype=np.int64), np.empty(2)
    for k in range(40):
        excitation(S[k], k, window, values, steps, ends, out)
        largest = np.abs(S[max(0, k - window + 1) : k + 1]).max(axis=0)
        share = np.divide(np.abs(S[k]), largest, out=np.zeros((2, 3)), where=largest > 0)
        assert out == pytest.approx(share.sum(axis=1), rel=1e-14)
