"""F2^+, in which the states that no noise enters have no part."""

import numpy as np
import pytest
from numba import float64, int64

from noiseid_cli.estimators.process_moment import left_inverse, scratch
from noiseid_cli.models.arrays import copy_matrix
from noiseid_cli.models.jit import kernel


@kernel(int64(float64[:, :, ::1], float64[:, :, ::1], float64[:, :, ::1]), allocates=True)
def left_inverses(gains, L, Lt):
    """Of each of the gains, one after the other with the same scratch; how many have full column rank."""
    count, n, nv = gains.shape
    s = scratch(n, nv, nv)
    regular = 0
    for k in range(count):
        if left_inverse(gains[k], s):
            regular += 1
            copy_matrix(s.L, L[k])
            copy_matrix(s.Lt[:, :nv], Lt[k])
    return regular


def computed(gains):
    count, n, nv = gains.shape
    L, Lt = np.full((count, nv, n), np.nan), np.full((count, n, nv), np.nan)
    return left_inverses(np.ascontiguousarray(gains), L, Lt), L, Lt


@pytest.mark.parametrize(("n", "nv"), [(1, 1), (3, 2), (8, 4), (13, 9)])
def test_it_is_the_pseudoinverse_whichever_states_the_noise_enters(n, nv):
    rng = np.random.default_rng(n)
    gains = rng.normal(size=(40, n, nv)) * 10.0 ** rng.uniform(-6, 6, (40, 1, nv))
    for gain in gains:
        gain[rng.permutation(n)[: rng.integers(n - nv + 1)]] = 0.0
    regular, L, Lt = computed(gains)
    assert regular == 40
    for gain, own, transposed in zip(gains, L, Lt, strict=True):
        scale = np.linalg.norm(gain, axis=0)
        expected = np.linalg.pinv(gain / scale) / scale[:, None]
        error = np.abs(own - expected).max(axis=1) * scale
        # A column's scale drops out; 8 n eps cond^2 is what a least-squares solution may lose.
        assert np.all(error <= 8 * n * np.finfo(float).eps * np.linalg.cond(gain / scale) ** 2)
        assert np.all(own[:, np.all(gain == 0.0, axis=1)] == 0.0)
        assert np.array_equal(transposed, own.T)


def test_dependent_columns_and_noise_that_enters_too_few_states_are_told():
    gains = np.zeros((3, 4, 2))
    gains[0, :, 0] = [1.0, 2.0, 0.0, 3.0]
    gains[0, :, 1] = -2.0 * gains[0, :, 0]
    gains[1, 2] = [1.0, 2.0]  # gains[2] is zero
    assert computed(gains)[0] == 0
