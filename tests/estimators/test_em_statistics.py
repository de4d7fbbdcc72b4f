"""The E-step against the paper's stacked state, the dense Gaussian, and Fisher's identity."""

from dataclasses import fields

import numpy as np
import pytest
from dense_gaussian import dense_posterior
from pendulum import pendulum_case
from random_models import random_case
from stacked_state import stacked_m_step

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.em_statistics import FILTERED, SMOOTHED, e_step
from noiseid_cli.models.linear import linear_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording
from noiseid_cli.models.threads import use_threads

BOTH = pytest.mark.parametrize("linearisation", [SMOOTHED, FILTERED])


@pytest.mark.parametrize("seed", range(3))
def test_m_step_equals_the_papers_stacked_state(seed):
    model, noise, recordings = pendulum_case(seed, missing=0.1 * seed)
    Q, _ = stacked_m_step(model, recordings[0], noise)
    assert np.max(np.abs(e_step(model, recordings, noise).moment_v - Q)) <= 1e-10 * np.max(Q)


@BOTH
@pytest.mark.parametrize("seed", range(10))
def test_moments_equal_the_dense_posterior(seed, linearisation):
    """Two tests of different length with missing outputs; R is one full block, so missing errors are completed."""
    case = random_case(seed, 3, 2, 3, lengths=(8, 13), missing=0.3)
    noise, n, nv = case.noise, 3, 2
    vv, ee = np.zeros((nv, nv)), np.zeros((3, 3))
    steps = samples = 0
    for i, recording in enumerate(case.recordings):
        mean, cov, _ = dense_posterior(
            case.A, case.B, case.G, case.C, case.D, recording, noise.Q, noise.R, noise.m0[i], noise.P0
        )
        N = recording.samples
        for k in range(N - 1):
            v = slice(N * n + k * nv, N * n + (k + 1) * nv)
            vv += cov[v, v] + np.outer(mean[v], mean[v])
            steps += 1
        for k in range(N):
            seen = ~np.isnan(recording.y[k])
            if not seen.any():
                continue
            x = slice(k * n, (k + 1) * n)
            # E[e e' | y]: e_o = y_o - h_o(x), e_m | e_o by the regression under R.
            r = (recording.y[k] - case.C @ mean[x] - case.D @ recording.u[k])[seen]
            oo = case.C[seen] @ cov[x, x] @ case.C[seen].T + np.outer(r, r)
            B = noise.R[:, seen] @ np.linalg.inv(noise.R[np.ix_(seen, seen)])
            rest = noise.R - B @ noise.R[seen]
            ee += B @ oo @ B.T + rest
            samples += 1
    statistics = e_step(case.model, case.recordings, noise, linearisation, np.zeros(3, dtype=np.int64))
    assert statistics.steps == steps
    assert np.all(statistics.samples == samples)
    assert np.allclose(statistics.moment_v, vv / steps, rtol=1e-9, atol=1e-11)
    assert np.allclose(statistics.moment_e, ee / samples, rtol=1e-9, atol=1e-11)


def score(case, noise, which, linearisation, blocks):
    """Gradient of the log-likelihood in one covariance, by Fisher's identity from the moments."""
    s = e_step(case.model, case.recordings, noise, linearisation, blocks)
    if which == "Q":
        inverse, count, moment = np.linalg.inv(noise.Q), s.steps, s.moment_v
        return count / 2 * inverse @ (moment - noise.Q) @ inverse
    inverse, moment = np.linalg.inv(noise.R), s.moment_e
    return s.samples[0] / 2 * inverse @ (moment - noise.R) @ inverse


@BOTH
@pytest.mark.parametrize("which", ["Q", "R"])
@pytest.mark.parametrize("seed", range(10))
def test_fishers_identity(seed, which, linearisation):
    case = random_case(50 + seed, 3, 2, 2, lengths=(15, 9), missing=0.25)
    blocks = np.zeros(2, dtype=np.int64)
    ours = score(case, case.noise, which, linearisation, blocks)
    for i in range(2):
        for j in range(i + 1):
            E = np.zeros((2, 2))
            E[i, j] = E[j, i] = 1.0
            h = 1e-4

            def loglik(t, E=E):
                values = {"Q": case.noise.Q, "R": case.noise.R}
                values[which] = values[which] + t * E
                noise = NoiseValues(values["Q"], values["R"], case.noise.m0, case.noise.P0)
                return e_step(case.model, case.recordings, noise).loglik

            slope = (8 * (loglik(h) - loglik(-h)) - (loglik(2 * h) - loglik(-2 * h))) / (12 * h)
            assert abs(slope - np.sum(ours * E)) <= 1e-7 * (1 + np.max(np.abs(ours)))


def test_blocks_of_outputs_are_left_out_or_completed_on_their_own():
    """With R in blocks, an output that is not measured says nothing about its block, and nothing is made up for it."""
    case = random_case(7, 2, 1, 2, lengths=(30,), missing=0.0)
    R = np.diag([0.5, 2.0])
    noise = NoiseValues(case.noise.Q, R, case.noise.m0, case.noise.P0)
    y = case.recordings[0].y.copy()
    y[10:, 1] = np.nan
    recording = Recording("r", case.recordings[0].dt, case.recordings[0].u, y)
    own = e_step(case.model, [recording], noise, block_of=np.array([0, 1]))
    joint = e_step(case.model, [recording], noise, block_of=np.array([0, 0]))
    assert own.samples.tolist() == [30, 10]
    # Completion adds R_22 for each of the 20 missing values (R is diagonal, nothing is learnt about them).
    assert np.isclose(30 * joint.moment_e[1, 1], 10 * own.moment_e[1, 1] + 20 * R[1, 1], rtol=1e-12)
    assert np.isclose(joint.moment_e[0, 0], own.moment_e[0, 0], rtol=1e-12)


def test_without_unknown_R_no_measurement_moments_are_gathered():
    case = random_case(8)
    assert np.all(e_step(case.model, case.recordings, case.noise).samples == 0)


def test_dependent_noise_gains_are_named():
    model = linear_model([[0.5]], [[1.0, 2.0]], [[1.0]])
    recording = Recording("run", np.ones(3), np.zeros((4, 0)), np.ones((4, 1)))
    noise = NoiseValues(np.eye(2), np.eye(1), np.zeros((1, 1)), np.eye(1))
    with pytest.raises(
        EstimationError, match="'run', sample 1: the columns of the noise gain F2 are linearly dependent"
    ):
        e_step(model, [recording], noise)
    # The filter's own linearisation needs no inverse of F2: the posterior of v exists all the same.
    assert np.all(np.isfinite(e_step(model, [recording], noise, FILTERED).moment_v))


@pytest.mark.parametrize("seed", range(3))
def test_linearisations_agree_where_the_model_is_nearly_linear(seed):
    """Small noise, small angles: both linearise at nearly the same states; they differ, but little."""
    model, noise, recordings = pendulum_case(seed, q=0.02, r=(0.001, 0.02))
    a, b = (e_step(model, recordings, noise, kind).moment_v for kind in (SMOOTHED, FILTERED))
    assert 0.0 < abs(a[0, 0] - b[0, 0]) < 1e-2 * a[0, 0]


def test_threads_change_no_bit():
    case = random_case(2, 3, 2, 3, lengths=(8, 13, 5, 9, 6), missing=0.3)
    blocks = np.zeros(3, dtype=np.int64)
    one = e_step(case.model, case.recordings, case.noise, block_of=blocks)
    with use_threads(3):
        three = e_step(case.model, case.recordings, case.noise, block_of=blocks)
    for field in fields(one):
        assert np.array_equal(getattr(one, field.name), getattr(three, field.name)), field.name
