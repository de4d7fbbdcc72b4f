"""The adaptive filter: its derivatives, its batch and online forms, missing data, its gate."""

import gc
import weakref
from dataclasses import replace

import numpy as np
import pytest
from pendulum import Pendulum, pendulum_case

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.adaptive_srukf import AdaptiveFilter, AdaptiveOptions
from noiseid_cli.estimators.structure import CovarianceStructure
from noiseid_cli.estimators.unknowns import ParameterUnknowns, Unknowns
from noiseid_cli.filters.ekf import OK
from noiseid_cli.filters.sigma_points import unscented
from noiseid_cli.filters.srukf import square_root_unscented_filter

NAMES = ("g", "c")


def problem(theta, options, noise, compiled, Q=True, model=None, **keywords):
    """A filter for the variance of v1, gravity and damping, at theta."""
    start = replace(noise, Q=np.array([[theta[0]]])) if Q else noise
    unknowns = Unknowns(Q=CovarianceStructure.diagonal(start.Q)) if Q else Unknowns()
    values = np.asarray(theta[1:] if Q else theta, dtype=float)
    parameters = ParameterUnknowns(NAMES, values, np.full(2, -np.inf), np.full(2, np.inf))
    return AdaptiveFilter(model or Pendulum(), compiled, start, unknowns, parameters, options, **keywords)


def frozen(**keywords):
    """Theta = 0: the unknowns stay, the sensitivities run."""
    return AdaptiveOptions({"v1": 0.0, "g": 0.0, "c": 0.0}, monitor=False, variance_floor=0.0, **keywords)


def after(theta, options, noise, compiled, recording):
    """Workspace after the whole recording."""
    filter_ = problem(theta, options, noise, compiled)
    dt = np.concatenate(([0.0], recording.dt))
    assert filter_.take(recording.y, recording.u, dt, 1)[0] == OK
    return filter_._s


def relative(numeric, exact):
    return np.max(np.abs(numeric - exact)) / np.max(np.abs(exact))


@pytest.mark.parametrize(("alpha", "missing"), [(0.85, 0.0), (0.3, 0.3)])
def test_whole_filter_derivatives_against_central_differences(alpha, missing):
    # Gains included, theta frozen, P0 moderate; the noise gain depends on the state (rk4).
    compiled, noise, (recording,) = pendulum_case(1, lengths=(40,), missing=missing)
    noise = replace(noise, P0=1e-4 * np.eye(2))
    theta = np.array([0.25, 9.3, 0.35])
    options = frozen(alpha=alpha)
    exact = after(theta, options, noise, compiled, recording)
    for j in range(3):
        h = np.zeros(3)
        h[j] = 1e-5 * theta[j]
        up, down = (after(theta + s * h, options, noise, compiled, recording) for s in (1, -1))

        def slope(name, up=up, down=down, step=2 * h[j]):
            return (getattr(up, name) - getattr(down, name)) / step

        assert relative(slope("x"), exact.dx[j]) < 1e-6
        assert relative(slope("U"), exact.dU[j]) < 1e-6
        assert relative(slope("y_hat"), exact.dy[j]) < 1e-6
        P = exact.dU[j].T @ exact.U + exact.U.T @ exact.dU[j]
        assert pytest.approx(P, rel=1e-9, abs=1e-12) == exact.dP[j]


def test_with_theta_frozen_it_is_the_plain_filter():
    compiled, noise, (recording,) = pendulum_case(2, lengths=(30,), missing=0.2)
    plain = square_root_unscented_filter(compiled, recording, noise, unscented(2, 0.4, 1.5, 0.3))
    theta = np.array([noise.Q[0, 0], 9.0, 0.3])
    filter_ = problem(theta, frozen(alpha=0.4, beta=1.5, kappa=0.3), noise, compiled)
    rows = filter_.take(recording.y, recording.u, np.concatenate(([0.0], recording.dt)), 1)[2]
    assert rows[0] == pytest.approx(plain.m_filt, rel=1e-11, abs=1e-12)
    assert rows[1] == pytest.approx(np.sqrt(np.sum(plain.U_filt**2, axis=1)), rel=1e-11)
    assert filter_.loglik == pytest.approx(plain.loglik, rel=1e-12)
    assert np.array_equal(rows[2], np.tile(theta, (30, 1)))


def running(**keywords):
    return AdaptiveOptions({"v1": 1e-3, "g": 1.0, "c": 0.1}, **{"monitor": False, **keywords})


@pytest.mark.parametrize("window", [0, 7])
def test_sample_by_sample_is_the_batch_to_the_bit(window):
    compiled, noise, (recording,) = pendulum_case(3, lengths=(40,), missing=0.3)
    recording.y[11] = np.nan
    options, theta = running(monitor=True, window=window, thresholds={"c": 1.2}), [0.2, 11.0, 0.5]
    batch = problem(theta, options, noise, compiled, longest=40)
    dt = np.concatenate(([0.0], recording.dt))
    rows = batch.take(recording.y, recording.u, dt, 1)[2]
    online = problem(theta, options, noise, compiled)
    for k in range(40):
        sample = online.step(recording.y[k], recording.u[k], dt[k])
        got = (sample.x, sample.x_std, sample.theta, sample.theta_std, sample.excitation)
        got += (sample.excitation_open_loop, sample.gate)
        assert all(np.array_equal(a, b[k]) for a, b in zip(got, rows, strict=True))
    assert 0.0 < rows[6][:, 2].mean() < 1.0
    assert rows[6][:, 0].all()
    # Where nothing is measured the unknowns stay.
    assert np.array_equal(rows[2][11], rows[2][10])
    assert np.array_equal(rows[3][11], rows[3][10])


def test_every_fifth_sample_is_kept():
    compiled, noise, (recording,) = pendulum_case(3, lengths=(12,))
    dt = np.concatenate(([0.0], recording.dt))
    all_rows, fifth = (
        problem([0.2, 11.0, 0.5], running(), noise, compiled).take(recording.y, recording.u, dt, stride)[2]
        for stride in (1, 5)
    )
    assert all(np.array_equal(a[::5], b) for a, b in zip(all_rows, fifth, strict=True))


def test_closed_gates_hold_parameters_and_leave_variances():
    compiled, noise, (recording,) = pendulum_case(4, lengths=(50,))
    theta = np.array([0.2, 11.0, 0.5])
    filter_ = problem(theta, running(monitor=True, thresholds={"g": 2.0, "c": 2.0}), noise, compiled)
    rows = filter_.take(recording.y, recording.u, np.concatenate(([0.0], recording.dt)), 1)[2]
    assert np.array_equal(rows[2][:, 1:], np.tile(theta[1:], (50, 1)))
    # No forgetting behind a closed gate: what was not learnt does not fade.
    assert rows[3][:, 1:] == pytest.approx(np.tile([1.0, np.sqrt(0.1)], (50, 1)), rel=1e-12)
    assert np.ptp(rows[2][:, 0]) > 0


def test_a_new_test_goes_on_with_theta_and_begins_with_the_prior():
    compiled, noise, recordings = pendulum_case(5, lengths=(40, 30))
    filter_ = problem([0.2, 11.0, 0.5], running(), noise, compiled)
    first = recordings[0]
    filter_.take(first.y, first.u, np.concatenate(([0.0], first.dt)), 1)
    theta, std = filter_.theta, filter_.theta_std
    filter_.restart(1)
    assert np.array_equal(filter_._s.x, noise.m0[1])
    assert not filter_._s.dU.any()
    assert np.array_equal(filter_.theta, theta)
    assert np.array_equal(filter_.theta_std, std)


def test_a_bound_is_kept_and_counted():
    compiled, noise, (recording,) = pendulum_case(6, lengths=(200,))
    lower = ParameterUnknowns(NAMES, np.array([12.0, 0.4]), np.array([11.0, -np.inf]), np.array([np.inf, 0.45]))
    filter_ = AdaptiveFilter(Pendulum(), compiled, noise, Unknowns(), lower, AdaptiveOptions({"g": 1.0, "c": 0.1}))
    rows = filter_.take(recording.y, recording.u, np.concatenate(([0.0], recording.dt)), 1)[2]
    assert filter_.names == NAMES
    assert rows[2][:, 0].min() == 11.0
    assert rows[2][:, 1].max() <= 0.45
    assert filter_.projections["g"] == np.count_nonzero(rows[2][:, 0] == 11.0) > 0


def test_a_variance_stops_at_its_floor():
    compiled, noise, (recording,) = pendulum_case(7, lengths=(100,), q=0.01)
    filter_ = problem([4.0, 9.0, 0.3], running(variance_floor=0.5), noise, compiled)
    rows = filter_.take(recording.y, recording.u, np.concatenate(([0.0], recording.dt)), 1)[2]
    assert rows[2][:, 0].min() >= 2.0


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"parameter_covariance": {"v1": 1.0, "g": 1.0}}, "no entry for c"),
        ({"parameter_covariance": {"v1": 1.0, "g": 1.0, "c": 1.0, "z": 1.0}}, "names z, which is not estimated"),
        ({"parameter_covariance": {"v1": 1.0, "g": -1.0, "c": 1.0}}, "of g is -1"),
        ({"forgetting": 0.0}, "above 0 and at most 1"),
        ({"window": -1}, "number of samples"),
        ({"thresholds": {"v1": 0.1}}, "thresholds names v1"),
        ({"alpha": 0.0}, "spread of the sigma points"),
    ],
)
def test_options_that_do_not_fit_are_refused(change, sentence):
    compiled, noise, _ = pendulum_case(0)
    with pytest.raises(EstimationError, match=sentence):
        problem([0.2, 9.0, 0.3], replace(running(), **change), noise, compiled)


def test_problems_that_do_not_fit_are_refused():
    compiled, noise, _ = pendulum_case(0)
    none = ParameterUnknowns()
    with pytest.raises(EstimationError, match="nothing is unknown"):
        AdaptiveFilter(Pendulum(), compiled, noise, Unknowns(), none, running())
    scaled = Unknowns(Q=CovarianceStructure.scaled(noise.Q))
    with pytest.raises(EstimationError, match="structure: diagonal"):
        AdaptiveFilter(Pendulum(), compiled, noise, scaled, none, running())


def test_what_the_kernel_was_given_lives_as_long_as_the_filter_and_no_longer():
    compiled, noise, (recording,) = pendulum_case(2, lengths=(30,))
    kept, other = (problem([0.2, 9.0, 0.3], running(), noise, compiled) for _ in range(2))
    seen = weakref.ref(other._s.X)
    del other._s
    gc.collect()
    dt = np.concatenate(([0.0], recording.dt))
    for k in range(30):
        a = kept.step(recording.y[k], recording.u[k], dt[k])
        b = other.step(recording.y[k], recording.u[k], dt[k])
        assert all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))
    assert seen() is not None
    del other
    gc.collect()
    assert seen() is None


def test_a_sample_of_another_length_is_refused():
    compiled, noise, _ = pendulum_case(0)
    filter_ = problem([0.2, 9.0, 0.3], running(), noise, compiled)
    with pytest.raises(EstimationError, match="a sample has 3 outputs, 1 inputs; the model has 2 and 1"):
        filter_.step(np.zeros(3), np.zeros(1))
    with pytest.raises(EstimationError, match="a sample has 2 outputs, 0 inputs; the model has 2 and 1"):
        filter_.step(np.zeros(2), np.zeros(0))
    assert filter_.samples == 0


def test_a_failure_online_is_a_sentence():
    compiled, noise, _ = pendulum_case(0)
    filter_ = problem([0.2, 9.0, 0.3], running(), noise, compiled)
    filter_.step(np.zeros(2), np.zeros(1))
    with pytest.raises(EstimationError, match="sample 2: the"):
        filter_.step(np.zeros(2), np.array([np.inf]), 0.05)
