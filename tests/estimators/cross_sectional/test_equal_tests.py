"""Tests that share a filter give the numbers that each would give alone, whatever the number of threads."""

from dataclasses import fields, replace

import numpy as np
import pytest
from dense_cross_section import random_tests

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.cross_sectional.equal import BLOCK, equal_tests
from noiseid_cli.estimators.cross_sectional.evaluate import partitioned
from noiseid_cli.estimators.cross_sectional.problem import CrossSection
from noiseid_cli.models.threads import in_threads, use_threads

ALIKE = BLOCK + 5


@pytest.fixture
def problem():
    """ALIKE tests of one kind, then one of another length, one with other gaps and one with another map."""
    tests, theta, coordinates = random_tests(seed=3, lengths=(12, 9), varying=False)
    rng = np.random.default_rng(1)
    first, short = tests.recordings
    gaps = np.isnan(first.y)
    alike = [
        replace(first, name=f"alike-{i}", u=rng.normal(size=first.u.shape),
                y=np.where(gaps, np.nan, rng.normal(size=first.y.shape)))
        for i in range(ALIKE)
    ]  # fmt: skip
    other = replace(alike[0], name="gaps", y=np.where(np.arange(12)[:, None] == 4, np.nan, alike[0].y))
    T = tests.maps[0]
    recordings = (*alike, short, other, replace(alike[1], name="map"))
    return CrossSection(tests.family, recordings, (*(T,) * (ALIKE + 2), 2.0 * T)), theta, coordinates


def test_shared_filters_give_the_numbers_of_single_ones(problem):
    tests, theta, coordinates = problem
    together, statistics = partitioned(tests, theta, coordinates)
    for i in range(len(tests)):
        alone, own = partitioned(tests.select(slice(i, i + 1)), theta, coordinates)
        for field in fields(alone):
            got, expected = getattr(together, field.name)[i], getattr(alone, field.name)[0]
            np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())
        np.testing.assert_allclose(statistics.cross[i], own.cross[0], rtol=1e-12, atol=1e-12)


def test_tests_are_grouped_by_what_their_covariances_depend_on(problem):
    tests, theta, _ = problem
    groups = equal_tests(tests, theta.alpha)
    assert [len(g.which) for g in groups] == [BLOCK, ALIKE - BLOCK, 1, 1, 1]
    assert sorted(i for g in groups for i in g.which) == list(range(len(tests)))
    assert [g.recordings[0].name for g in groups[2:]] == ["alike-0", tests.recordings[ALIKE].name, "gaps", "map"][1:]


def test_threads_change_no_bit(problem):
    tests, theta, coordinates = problem
    one = partitioned(tests, theta, coordinates)[0]
    with use_threads(3):
        three = partitioned(tests, theta, coordinates)[0]
    for field in fields(one):
        assert np.array_equal(getattr(one, field.name), getattr(three, field.name))


def test_threads_keep_the_order_and_raise_the_first_error():
    def half(n):
        if n % 2:
            raise EstimationError(f"{n} is odd")
        return n // 2

    with use_threads(4):
        assert in_threads(half, range(0, 40, 2)) == list(range(20))
        with pytest.raises(EstimationError, match=r"^3 is odd"):
            in_threads(half, [2, 3, 5, 7])
