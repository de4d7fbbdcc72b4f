"""M-steps of structured covariances against direct maximisation, and the free coordinates."""

import numpy as np
import pytest
from random_models import random_covariance
from scipy.optimize import minimize

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.structure import CovarianceStructure


def objective(Q, S):
    return -(np.linalg.slogdet(Q)[1] + np.trace(np.linalg.solve(Q, S)))


def structures(start):
    p = len(start)
    diagonal = np.diag(np.diag(start))
    blocks = diagonal.copy()
    blocks[:2, :2] = start[:2, :2]
    return {
        "full": CovarianceStructure.full(start),
        "diagonal": CovarianceStructure.diagonal(diagonal),
        "blocks": CovarianceStructure(blocks, ((0, 1), tuple(range(2, p)))[: 1 if p == 2 else 2]),
        "scale": CovarianceStructure.scaled(start),
        "held variance": CovarianceStructure(start, (tuple(range(p)),), held=frozenset({(0, 0)})),
        "held covariance": CovarianceStructure(start, (tuple(range(p)),), held=frozenset({(1, 0)})),
        "zero pattern": CovarianceStructure(diagonal, (tuple(range(p)),), held=frozenset({(1, 0), (p - 1, 0)})),
    }


KINDS = list(structures(np.eye(3)))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(5))
def test_m_step_is_the_maximum_over_the_structure(kind, seed):
    rng = np.random.default_rng(seed)
    structure = structures(random_covariance(rng, 3))[kind]
    S = random_covariance(rng, 3)
    ours = structure.maximise(S, structure.start)
    assert np.array_equal(ours, ours.T)
    assert np.linalg.eigvalsh(ours)[0] > 0
    # No direction within the structure goes up: the slope along every free entry is zero.
    inverse = np.linalg.inv(ours)
    slope = inverse @ S @ inverse - inverse
    if structure.scale:
        assert abs(np.sum(slope * structure.start)) < 1e-9
    else:
        assert all(abs(slope[i, j]) < 1e-9 for i, j in structure.free)
        assert all(ours[i, j] == structure.start[i, j] for i, j in structure.held)

    def negative(z):
        Q = structure.covariance(z)
        return np.inf if np.linalg.eigvalsh(Q)[0] <= 0 else -objective(Q, S)

    found = minimize(negative, structure.coordinates(structure.start), method="Nelder-Mead",
                     options={"xatol": 1e-7, "fatol": 1e-12, "maxiter": 8000})  # fmt: skip
    assert objective(ours, S) >= -found.fun - 1e-9


@pytest.mark.parametrize("kind", KINDS)
def test_coordinates_come_back(kind):
    structure = structures(random_covariance(np.random.default_rng(3), 3))[kind]
    Q = structure.maximise(random_covariance(np.random.default_rng(4), 3), structure.start)
    back = structure.covariance(structure.coordinates(Q))
    assert np.allclose(back, Q, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("kind", ["full", "blocks", "diagonal", "scale"])
def test_any_coordinates_are_a_covariance(kind):
    structure = structures(random_covariance(np.random.default_rng(3), 3))[kind]
    size = len(structure.coordinates(structure.start))
    for seed in range(20):
        z = np.random.default_rng(seed).normal(scale=3.0, size=size)
        Q = structure.covariance(z)
        d = np.sqrt(np.diag(Q))
        assert np.linalg.eigvalsh(Q / np.outer(d, d))[0] > -1e-15


@pytest.mark.parametrize("kind", KINDS)
def test_units_shift_coordinates_only(kind):
    """Steps between two points are the same numbers in any units, so is then every decision taken on them."""
    rng = np.random.default_rng(9)
    start, other = random_covariance(rng, 3), random_covariance(rng, 3)
    t = np.diag([1e-6, 1.0, 1e5])
    here, there = structures(start)[kind], structures(t @ start @ t)[kind]
    a = here.maximise(other, here.start)
    b = there.maximise(t @ other @ t, there.start)
    step_here = here.coordinates(a) - here.coordinates(here.start)
    step_there = there.coordinates(b) - there.coordinates(there.start)
    assert np.allclose(step_here, step_there, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize(
    ("structure", "text"),
    [
        (CovarianceStructure.full(np.diag([1.0, 0.0]), "Q"), "start of Q has zero variance at position 2"),
        (CovarianceStructure.full(np.ones((2, 2)), "Q"), "start of Q is singular"),
        (CovarianceStructure.full(np.diag([1.0, np.inf]), "Q"), "start of Q has entries that are not finite"),
        (CovarianceStructure(np.array([[1.0, 0.1], [0.1, 1.0]]), ((0,), (1,)), what="R"), "entries across its blocks"),
        (CovarianceStructure(np.eye(1), ((0,),), held=frozenset({(0, 0)}), what="R"), "every entry of R is held"),
    ],
)
def test_starts_without_a_way_out_are_refused(structure, text):
    with pytest.raises(EstimationError, match=text):
        structure.check()


def test_an_entry_held_next_to_nothing_does_not_keep_the_search_from_its_end():
    """The held variance makes the objective 3e8: what the free one gains is below its rounding, and still found."""
    start = np.diag([3.9e-40, 2.1e-32])
    structure = CovarianceStructure(start, ((0,), (1,)), held=frozenset({(0, 0)}))
    found = structure.maximise(np.full((2, 2), 1.26e-31), start)
    assert found[0, 0] == start[0, 0]
    assert np.isclose(found[1, 1], 1.26e-31, rtol=1e-6)
