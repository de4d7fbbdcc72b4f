"""Exact discretisation with parameter derivatives, and the Markov-driven manipulator."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.linalg import expm

from noiseid_cli.errors import ModelError
from noiseid_cli.models.parametric import discretise
from noiseid_cli.models.recording import Recording
from tests.oracles.markov import (
    TRUE_ALPHA,
    TRUE_COVARIANCE,
    TRUE_MEAN,
    markov_matrices,
)
from tests.oracles.markov_tests import simulate_markov_tests

NAMES = ("A", "B", "Q", "C", "D", "R", "S_a")


def blank(dt):
    N = len(dt) + 1
    return Recording("blank", np.asarray(dt, float), np.zeros((N, 1)), np.full((N, 1), np.nan))


def test_discretisation_equals_the_integrals():
    rng = np.random.default_rng(1)
    F, L, W, dt = rng.normal(size=(3, 3)), rng.normal(size=(3, 2)), rng.normal(size=(3, 2)), 0.7
    none = np.zeros((0, 3, 3))
    A, B, Q, *_ = discretise(F, L, W @ W.T, none, np.zeros((0, 3, 2)), none, dt)
    np.testing.assert_allclose(A, expm(F * dt), rtol=1e-12)
    np.testing.assert_allclose(B, quad_vec(lambda s: expm(F * s) @ L, 0, dt, epsabs=1e-12)[0], rtol=1e-10)
    expected = quad_vec(lambda s: expm(F * s) @ W @ W.T @ expm(F * s).T, 0, dt, epsabs=1e-12)[0]
    np.testing.assert_allclose(Q, expected, rtol=1e-10, atol=1e-12)


def test_derivatives_of_the_discretisation_equal_differences():
    rng = np.random.default_rng(2)
    F, L, W = rng.normal(size=(3, 3)), rng.normal(size=(3, 1)), np.eye(3)
    dF, dL, dW = rng.normal(size=(1, 3, 3)), rng.normal(size=(1, 3, 1)), np.diag([1.0, 2.0, 0.5])[None]
    h = 1e-5
    plus, minus = (discretise(F + s * dF[0], L + s * dL[0], W + s * dW[0], dF, dL, dW, 0.4) for s in (h, -h))
    now = discretise(F, L, W, dF, dL, dW, 0.4)
    for i in range(3):
        np.testing.assert_allclose(now[3 + i][0], (plus[i] - minus[i]) / (2 * h), rtol=1e-7, atol=1e-9)


def test_a_mode_that_decays_within_the_interval_keeps_its_digits():
    """For x' = -r x + w, Q = q (1 - exp(-2 r dt)) / (2 r), whatever r dt; dQ/dr by hand."""
    one = np.ones((1, 1))
    for r in (1e-3, 0.7, 40.0, 1e4):
        A, B, Q, dA, dB, dQ = discretise(-r * one, one, 3.0 * one, -one[None], 0 * one[None], 0 * one[None], 2.0)
        decay = np.exp(-2.0 * r)
        np.testing.assert_allclose([A, B], [decay * one, -np.expm1(-2.0 * r) / r * one], rtol=1e-12)
        np.testing.assert_allclose(Q, -3.0 * np.expm1(-4.0 * r) / (2.0 * r) * one, rtol=1e-12)
        np.testing.assert_allclose(dA[0], -2.0 * decay * one, rtol=1e-11)
        np.testing.assert_allclose(dB[0], (2.0 * decay * r + np.expm1(-2.0 * r)) / r**2 * one, rtol=1e-9)
        by_hand = 3.0 * (4.0 * r * decay**2 + np.expm1(-4.0 * r)) / (2.0 * r**2)
        np.testing.assert_allclose(dQ[0], by_hand * one, rtol=1e-9)


@pytest.mark.parametrize("dt", [[1.0] * 3, [1.0, 0.5, 0.25], []])
def test_manipulator_matrices_and_derivatives(dt):
    recording, h = blank(dt), 1e-6
    now = markov_matrices(TRUE_ALPHA, recording)
    assert len(now.A) == max(len(set(dt)), 1)
    for a in range(2):
        step = h * TRUE_ALPHA[a] * np.eye(2)[a]
        plus, minus = (markov_matrices(TRUE_ALPHA + s * step, recording) for s in (1, -1))
        for name in NAMES:
            difference = (getattr(plus, name) - getattr(minus, name)) / (2 * h * TRUE_ALPHA[a])
            np.testing.assert_allclose(getattr(now, "d" + name)[a], difference, rtol=1e-6, atol=1e-8)
    # x3 is stationary: its variance stays q tau / 2.
    for A, Q in zip(now.A, now.Q, strict=True):
        assert A[2, 2] ** 2 * now.S_a[2, 2] + Q[2, 2] == pytest.approx(now.S_a[2, 2], rel=1e-12)


def test_manipulator_refuses_what_is_not_positive():
    with pytest.raises(ModelError, match="must be positive"):
        markov_matrices(np.array([0.02, 0.0]), blank([1.0]))


def test_shapes_are_checked():
    m = markov_matrices(TRUE_ALPHA, blank([1.0]))
    with pytest.raises(ModelError, match="matrix B has shape"):
        replace(m, B=m.B[:, :2])
    with pytest.raises(ModelError, match="derivative dC has shape"):
        replace(m, dC=m.dC[:1])
    with pytest.raises(ModelError, match="S_a and dS_a"):
        replace(m, S_a=np.eye(2))


def test_ensemble_draws_its_first_states_from_the_law_and_stays_put():
    tests = simulate_markov_tests(400, 1, samples=30)
    first = np.array([t.x_true[0] for t in tests])
    law = np.diag([*np.diag(TRUE_COVARIANCE), TRUE_ALPHA[0] / (2 * TRUE_ALPHA[1])])
    mean = np.append(TRUE_MEAN, 0.0)
    assert np.all(np.abs(first.mean(axis=0) - mean) < 4 * np.sqrt(np.diag(law) / 400))
    spread = np.var(first, axis=0, ddof=1) / np.diag(law)
    assert np.all(np.abs(spread - 1) < 4 * np.sqrt(2 / 400))
    noise = np.concatenate([t.y[1:, 0] - t.x_true[1:, 0] for t in tests])
    assert abs(np.var(noise) / 0.0025 - 1) < 4 * np.sqrt(2 / len(noise))
    for t in tests[:5]:
        assert np.isnan(t.y[0, 0])
        assert t.u[0, 0] == 0.0
    # The loop is closed: position stays within what its noise gives.
    assert max(np.abs(t.x_true[10:, 0]).max() for t in tests) < 10.0


def test_ensemble_is_repeatable_and_does_not_depend_on_how_many_follow():
    few, many = (
        simulate_markov_tests(2, 7, samples=lambda i: 10 + i),
        simulate_markov_tests(5, 7, samples=lambda i: 10 + i),
    )
    for a, b in zip(few, many, strict=False):
        np.testing.assert_array_equal(a.y, b.y)
    assert [t.samples for t in many] == [11, 12, 13, 14, 15]
