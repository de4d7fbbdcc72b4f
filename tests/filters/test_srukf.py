"""The square-root unscented filter against its covariance-form twin and, on linear models, the Kalman filter."""

from dataclasses import replace

import numpy as np
import pytest
from pendulum import pendulum_case
from random_models import random_case
from unscented_twin import unscented_twin

from noiseid_cli.errors import EstimationError
from noiseid_cli.filters.ekf import FilterDivergedError, extended_kalman_filter
from noiseid_cli.filters.sigma_points import cubature, unscented
from noiseid_cli.filters.srukf import SquareRootUnscentedFilter, square_root_unscented_filter
from noiseid_cli.models.schemes import DENSITY, EXACT


def covariances(U):
    return U.transpose(0, 2, 1) @ U


@pytest.mark.parametrize("seed", range(6))
def test_linear_models_give_the_kalman_filter(seed):
    case = random_case(seed, n=1 + seed % 4, nv=1 + seed % 2, ny=1 + seed % 3, missing=0.3)
    kalman = extended_kalman_filter(case.model, case.recordings[0], case.noise)
    for weights in (unscented(case.model.nx, 0.3, 2.0), cubature(case.model.nx)):
        ours = square_root_unscented_filter(case.model, case.recordings[0], case.noise, weights)
        assert ours.m_filt == pytest.approx(kalman.m_filt, rel=1e-9, abs=1e-9)
        assert ours.m_pred == pytest.approx(kalman.m_pred, rel=1e-9, abs=1e-9)
        assert covariances(ours.U_filt) == pytest.approx(covariances(kalman.U_filt), rel=1e-9, abs=1e-9)
        assert covariances(ours.U_pred) == pytest.approx(covariances(kalman.U_pred), rel=1e-9, abs=1e-9)
        assert ours.loglik == pytest.approx(kalman.loglik, rel=1e-10)


def test_exact_discretisation_and_densities():
    case = random_case(7, n=2, nv=2)
    compiled, dt = replace(case.model, scheme=EXACT + DENSITY), np.linspace(0.05, 0.2, 19)
    recording = replace(case.recordings[0], dt=dt)
    kalman = extended_kalman_filter(compiled, recording, case.noise)
    ours = square_root_unscented_filter(compiled, recording, case.noise, unscented(2, 0.5))
    assert ours.m_filt == pytest.approx(kalman.m_filt, rel=1e-9, abs=1e-9)
    assert ours.loglik == pytest.approx(kalman.loglik, rel=1e-10)


@pytest.mark.parametrize("weights", [unscented(2, 0.5, 2.0), unscented(2, 1.0, 0.0, 0.5), cubature(2)])
def test_nonlinear_filter_equals_the_covariance_form(weights):
    model, noise, (recording,) = pendulum_case(3, lengths=(60,), missing=0.3)
    recording.y[5] = np.nan
    ours = square_root_unscented_filter(model, recording, noise, weights)
    means, P, loglik = unscented_twin(model, recording, noise, weights)
    assert ours.m_filt == pytest.approx(means, rel=1e-10, abs=1e-10)
    assert covariances(ours.U_filt) == pytest.approx(P, rel=1e-9, abs=1e-12)
    assert ours.loglik == pytest.approx(loglik, rel=1e-10)
    assert ours.restacked == 0
    assert np.array_equal(np.isnan(ours.innovation), np.isnan(recording.y))


def test_sample_by_sample_is_the_batch_to_the_bit():
    model, noise, (recording,) = pendulum_case(4, lengths=(30,), missing=0.2)
    batch = square_root_unscented_filter(model, recording, noise, unscented(2, 0.4))
    online = SquareRootUnscentedFilter(model, noise, unscented(2, 0.4))
    for k in range(recording.samples):
        mean, std = online.step(recording.y[k], recording.u[k], recording.dt[k - 1] if k else 0.0)
        assert np.array_equal(mean, batch.m_filt[k])
        assert np.array_equal(online.factor, batch.U_filt[k])
        assert std == pytest.approx(np.sqrt(np.diag(covariances(batch.U_filt)[k])), rel=1e-14)
    assert online.loglik == pytest.approx(batch.loglik, rel=1e-13)
    assert np.array_equal(online.mean, batch.m_filt[-1])


def test_noise_added_to_the_states_is_process_noise_with_gain_one():
    case = random_case(11, n=2, nv=2)
    model = replace(case, G=np.eye(2)).model
    Q = case.noise.Q
    with_gain = square_root_unscented_filter(model, case.recordings[0], case.noise, unscented(2, 0.5))
    added = square_root_unscented_filter(
        model, case.recordings[0], replace(case.noise, Q=np.zeros((2, 2))), unscented(2, 0.5), added=Q
    )
    assert added.m_filt == pytest.approx(with_gain.m_filt, abs=1e-11)
    assert added.loglik == pytest.approx(with_gain.loglik, rel=1e-12)


def test_a_failed_downdate_is_replaced_and_counted():
    # Outputs a million times more exact than the prior: the corrected variance is lost in the rounding of the prior.
    case = random_case(0, n=2, nv=2, ny=2, missing=0.0)
    noise = replace(case.noise, R=1e-18 * np.eye(2))
    ours = square_root_unscented_filter(case.model, case.recordings[0], noise, unscented(2, 1.0))
    exact = extended_kalman_filter(case.model, case.recordings[0], noise)
    assert ours.restacked > 0
    assert covariances(ours.U_filt) == pytest.approx(covariances(exact.U_filt), rel=1e-4, abs=1e-21)


def test_failures_say_where_and_what():
    model, noise, (recording,) = pendulum_case(5)
    far = replace(noise, P0=np.diag([4.0, 4.0]))
    with pytest.raises(FilterDivergedError, match=r"indefinite .take a larger alpha. at sample"):
        square_root_unscented_filter(model, recording, far, unscented(2, 1.0, -20.0))
    broken = replace(recording, u=np.where(np.arange(40)[:, None] == 7, np.inf, recording.u))
    with pytest.raises(FilterDivergedError, match="no longer finite at sample 8"):
        square_root_unscented_filter(model, broken, noise, unscented(2, 0.5))
    online = SquareRootUnscentedFilter(model, noise, unscented(2, 0.5))
    with pytest.raises(EstimationError, match="sample 1: the estimate is no longer finite"):
        online.step(np.zeros(2), np.array([np.nan]))
