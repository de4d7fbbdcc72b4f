"""Filter and smoother against the dense joint Gaussian and the covariance-form twin."""

import numpy as np
import pytest
from covariance_form import filter_twin, smoother_twin
from dense_gaussian import dense_posterior
from random_models import random_case

from noiseid_cli.errors import EstimationError
from noiseid_cli.filters.ekf import FilterDivergedError, extended_kalman_filter
from noiseid_cli.filters.smoother import extended_kalman_smoother, filter_to_smooth
from noiseid_cli.models.linear import linear_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording

SIZES = [(1, 1, 1), (2, 1, 2), (3, 2, 2), (4, 2, 3), (2, 2, 1)]


def close(a, b, tolerance):
    return np.max(np.abs(a - b)) <= tolerance * (1.0 + np.max(np.abs(b)))


@pytest.mark.parametrize("seed", range(40))
def test_smoother_equals_the_dense_joint_gaussian(seed):
    n, nv, ny = SIZES[seed % len(SIZES)]
    case = random_case(seed, n, nv, ny, missing=0.3 if seed % 2 else 0.0)
    recording, noise = case.recordings[0], case.noise
    N = recording.samples
    mean, cov, loglik = dense_posterior(
        case.A, case.B, case.G, case.C, case.D, recording, noise.Q, noise.R, noise.m0[0], noise.P0
    )
    filtered = filter_to_smooth(case.model, recording, noise)
    smoothed = extended_kalman_smoother(filtered)

    assert abs(filtered.loglik - loglik) <= 1e-11 * (1 + abs(loglik))
    assert close(smoothed.m.ravel(), mean[: N * n], 1e-10)
    for k in range(N):
        now = slice(k * n, (k + 1) * n)
        assert close(smoothed.P[k], cov[now, now], 1e-9)
        if k < N - 1:
            after = slice((k + 1) * n, (k + 2) * n)
            assert close(smoothed.lag_one[k], cov[after, now], 1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_noise_part_of_the_smoother_is_the_dense_posterior_of_v(seed):
    n, nv, ny = SIZES[seed % len(SIZES)]
    case = random_case(100 + seed, n, nv, ny)
    recording, noise = case.recordings[0], case.noise
    N = recording.samples
    mean, cov, _ = dense_posterior(
        case.A, case.B, case.G, case.C, case.D, recording, noise.Q, noise.R, noise.m0[0], noise.P0
    )
    filtered = filter_to_smooth(case.model, recording, noise)
    smoothed = extended_kalman_smoother(filtered)
    for k in range(N - 1):
        v = slice(N * n + k * nv, N * n + (k + 1) * nv)
        Xv, Cv = smoothed.gain[k, n:], smoothed.C[k][:, n:]
        assert close(Xv @ (smoothed.m[k + 1] - filtered.m_pred[k + 1]), mean[v], 1e-10)
        assert close(Cv.T @ Cv + Xv @ smoothed.P[k + 1] @ Xv.T, cov[v, v], 1e-9)


@pytest.mark.parametrize("seed", range(10))
def test_filter_and_smoother_equal_the_covariance_form(seed):
    case = random_case(200 + seed, 4, 2, 3, lengths=(60,))
    recording, noise = case.recordings[0], case.noise
    twin = filter_twin(case.model, recording, noise)
    filtered = extended_kalman_filter(case.model, recording, noise)
    for ours, theirs in [
        (filtered.m_pred, twin.m_pred),
        (filtered.m_filt, twin.m_filt),
        (filtered.chol_pred @ filtered.U_pred, twin.P_pred),
        (filtered.chol_filt @ filtered.U_filt, twin.P_filt),
    ]:
        assert close(ours, np.array(theirs), 1e-10)
    assert abs(filtered.loglik - twin.loglik) <= 1e-10 * abs(twin.loglik)
    m, P, lag = smoother_twin(twin)
    smoothed = extended_kalman_smoother(filter_to_smooth(case.model, recording, noise))
    assert close(smoothed.m, m, 1e-10)
    assert close(smoothed.P, P, 1e-10)
    assert close(smoothed.lag_one, lag, 1e-10)


@pytest.mark.parametrize("P0", [np.zeros((2, 2)), np.diag([1.0, 0.0])])
@pytest.mark.parametrize("A", [[[0.0, 0.0], [1.0, 0.0]], [[0.5, 0.2], [0.0, 0.0]], [[0.9, 0.1], [0.0, 0.8]]])
def test_singular_predictions_are_exact_too(A, P0):
    """A delay line forgets a state, a known start knows one: P_pred has no inverse, the posterior still exists."""
    A = np.array(A)
    B, G, C, D = np.zeros((2, 1)), np.array([[1.0], [0.0]]), np.array([[0.3, 1.0]]), np.zeros((1, 1))
    rng = np.random.default_rng(5)
    recording = Recording("r", np.ones(5), np.zeros((6, 1)), rng.normal(size=(6, 1)))
    Q, R, m0 = np.array([[0.7]]), np.array([[0.4]]), np.array([0.2, -0.1])
    mean, cov, loglik = dense_posterior(A, B, G, C, D, recording, Q, R, m0, P0)
    model = linear_model(A, G, C, B, D)
    filtered = filter_to_smooth(model, recording, NoiseValues(Q, R, m0[None], P0))
    smoothed = extended_kalman_smoother(filtered)
    assert abs(filtered.loglik - loglik) < 1e-12
    assert close(smoothed.m.ravel(), mean[:12], 1e-12)
    for k in range(6):
        now = slice(2 * k, 2 * k + 2)
        assert close(smoothed.P[k], cov[now, now], 1e-12)
        if k < 5:
            assert close(smoothed.lag_one[k], cov[2 * k + 2 : 2 * k + 4, now], 1e-12)


def test_singular_predictions_are_counted():
    model = linear_model([[0.0, 0.0], [1.0, 0.0]], [[0.0], [0.0]], [[1.0, 1.0]])
    recording = Recording("r", np.ones(3), np.zeros((4, 0)), np.ones((4, 1)))
    noise = NoiseValues(np.eye(1), np.eye(1), np.zeros((1, 2)), np.eye(2))
    forward = filter_to_smooth(model, recording, noise)
    assert extended_kalman_smoother(forward).singular == forward.singular == 3


@pytest.mark.parametrize("exponent", [4, 8, 12, 16])
def test_badly_scaled_prior_against_many_digits(exponent):
    """P0/R up to 1e16: P within 1e-6, log-likelihood within 1e-9 of 60-digit arithmetic."""
    mpmath = pytest.importorskip("mpmath")
    A, G, C = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[0.0], [0.1]]), np.array([[1.0, 0.0]])
    rng = np.random.default_rng(3)
    y = np.cumsum(rng.normal(size=(30, 1)), axis=0)
    noise = NoiseValues(np.eye(1), np.eye(1) * 10.0**-exponent, np.zeros((1, 2)), np.eye(2))
    recording = Recording("r", np.ones(29), np.zeros((30, 0)), y)
    filtered = extended_kalman_filter(linear_model(A, G, C), recording, noise)

    with mpmath.workdps(60):
        mp = mpmath.matrix
        P, m, loglik = mp(np.eye(2).tolist()), mp([0, 0]), mpmath.mpf(0)
        Am, Gm, Cm = mp(A.tolist()), mp(G.tolist()), mp(C.tolist())
        for k in range(30):
            S = (Cm * P * Cm.T)[0] + mpmath.mpf(float(noise.R[0, 0]))
            nu = mpmath.mpf(float(y[k, 0])) - (Cm * m)[0]
            loglik -= (mpmath.log(2 * mpmath.pi * S) + nu**2 / S) / 2
            K = P * Cm.T / S
            m, P = m + K * nu, P - K * S * K.T
            last = P
            m, P = Am * m, Am * P * Am.T + Gm * Gm.T
        exact = np.array([[float(last[i, j]) for j in range(2)] for i in range(2)])
    ours = filtered.U_filt[-1].T @ filtered.U_filt[-1]
    assert np.max(np.abs(ours - exact) / np.abs(exact)) < 1e-6
    assert abs(filtered.loglik - float(loglik)) <= 1e-9 * abs(float(loglik))


def test_divergence_names_test_and_sample():
    model = linear_model([[1e100]], [[1.0]], [[1.0]])
    recording = Recording("run 7", np.ones(9), np.zeros((10, 0)), np.full((10, 1), np.nan))
    noise = NoiseValues(np.eye(1), np.eye(1), np.ones((1, 1)), np.eye(1))
    with pytest.raises(FilterDivergedError, match=r"'run 7': the estimate is no longer finite at sample 3 of 10"):
        extended_kalman_filter(model, recording, noise)


def test_exactly_known_output_is_refused():
    model = linear_model([[1.0]], [[1.0]], [[1.0], [1.0]])
    recording = Recording("r", np.ones(2), np.zeros((3, 0)), np.ones((3, 2)))
    noise = NoiseValues(np.eye(1), np.zeros((2, 2)), np.zeros((1, 1)), np.eye(1))
    with pytest.raises(FilterDivergedError, match="innovation covariance is singular"):
        extended_kalman_filter(model, recording, noise)


@pytest.mark.parametrize(
    ("Q", "text"),
    [
        ([[1.0, 0.5], [0.4, 1.0]], "not symmetric"),
        ([[1.0, 2.0], [2.0, 1.0]], "smallest eigenvalue is -1"),
        ([[np.nan, 0.0], [0.0, 1.0]], "not finite"),
    ],
)
def test_faulty_covariances_are_refused(Q, text):
    case = random_case(1)
    noise = NoiseValues(np.array(Q), case.noise.R, case.noise.m0, case.noise.P0)
    with pytest.raises(EstimationError, match=text):
        extended_kalman_filter(case.model, case.recordings[0], noise)
