"""asrukf, sb-asrukf and joint-srukf as estimates: they find the truth, and say what happened."""

from dataclasses import replace

import numpy as np
import pytest
from pendulum import Pendulum, pendulum_case

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators import adaptive_estimate, joint_srukf
from noiseid_cli.estimators.adaptive_srukf import AdaptiveOptions
from noiseid_cli.estimators.joint_srukf import JointFilter, JointOptions
from noiseid_cli.estimators.structure import CovarianceStructure
from noiseid_cli.estimators.unknowns import ParameterUnknowns, Unknowns
from noiseid_cli.filters.sigma_points import unscented
from noiseid_cli.filters.srukf import square_root_unscented_filter
from noiseid_cli.models.compile import compile_model
from noiseid_cli.models.stacked import stack_parameters

TRUE = np.array([9.0, 0.3])
FREE = ParameterUnknowns(("g", "c"), np.array([12.0, 1.0]), np.full(2, -np.inf), np.full(2, np.inf))
COVARIANCE = {"g": 1.0, "c": 0.1}


def adaptive(recordings, compiled, noise, monitor=True, parameters=FREE, **keywords):
    start = replace(noise, Q=np.array([[1.0]]))
    unknowns = Unknowns(Q=CovarianceStructure.diagonal(start.Q))
    options = AdaptiveOptions({**COVARIANCE, "v1": 1e-4}, monitor=monitor, forgetting=0.9999, **keywords)
    return adaptive_estimate.estimate(Pendulum(), compiled, recordings, start, unknowns, parameters, options)


def joint(recordings, compiled, noise, parameters=FREE, parameter_noise=1e-8, **keywords):
    options = JointOptions(COVARIANCE, dict.fromkeys(COVARIANCE, parameter_noise), **keywords)
    return joint_srukf.estimate(Pendulum(), compiled, recordings, noise, parameters, options)


def series(estimate):
    return {s.name: s for s in estimate.series}


@pytest.mark.parametrize("method", ["asrukf", "sb-asrukf", "joint-srukf"])
def test_parameters_end_within_four_standard_errors_of_the_truth(method):
    compiled, noise, recordings = pendulum_case(1, lengths=(2500, 1500), missing=0.1)
    found = (
        joint(recordings, compiled, noise)
        if method == "joint-srukf"
        else adaptive(recordings, compiled, noise, method == "sb-asrukf", thresholds={"c": 0.2})
    )
    assert (found.method, found.status) == (method, "converged")
    assert np.all(np.abs(found.parameters.final - TRUE) < 4 * found.parameters.standard_errors)
    assert np.all(found.parameters.standard_errors < [0.1, 0.03])
    assert found.loglik > found.loglik_start + 1000
    rows = series(found)
    assert len(rows["parameters"].at) == 2000
    assert np.all(np.diff(rows["parameters"].at) > 0)
    assert rows["parameters"].at[1250] == pytest.approx(recordings[0].time[-1] + recordings[0].dt[-1])
    held = found.reason.partition("held: ")[2]
    assert ("c " in held) == (method == "sb-asrukf")
    expected = {"parameters", "parameters_std", "states", "states_std"}
    if method != "joint-srukf":
        expected |= {"sensitivity", "sensitivity_open_loop", "open"}
        assert [c[0] for c in rows["parameters"].columns] == ["v1", "g", "c"]
        assert rows["sensitivity"].values.max() <= 2.0
        assert not rows["sensitivity_open_loop"].values[:, 0].any()
        assert rows["sensitivity_open_loop"].values[:, 1:].max() > 0.5
    assert set(rows) == expected


def test_truth_goes_along():
    compiled, noise, (recording,) = pendulum_case(2, lengths=(30,))
    path = np.linspace([0.3, 9.0], [0.4, 8.0], 30)
    recording = replace(recording, x_true=np.arange(60.0).reshape(30, 2), parameters_true=path)
    for found in (adaptive([recording], compiled, noise), joint([recording], compiled, noise)):
        rows = series(found)
        assert np.array_equal(rows["parameters_true"].values, path[:, ::-1])  # g, c; the model declares c, g
        assert np.array_equal(rows["states_true"].values, recording.x_true)


def test_a_failure_keeps_what_was_found_before_it():
    compiled, noise, (recording,) = pendulum_case(3, lengths=(40,))
    recording.u[30] = 1.7e308  # a number, and too large for a step
    for found in (adaptive([recording], compiled, noise), joint([recording], compiled, noise)):
        assert found.status == "diverged"
        assert "no longer finite at sample 31 of 40" in found.reason
        assert len(series(found)["parameters"].values) == 30
        assert np.array_equal(found.parameters.final, series(found)["parameters"].values[-1, -2:])
        assert found.parameters.standard_errors is None
        assert np.isnan(found.loglik)


def test_bounds_are_kept_and_told():
    compiled, noise, (recording,) = pendulum_case(4, lengths=(300,))
    bounded = replace(FREE, lower=np.array([11.0, -np.inf]))
    for found in (
        adaptive([recording], compiled, noise, parameters=bounded),
        joint([recording], compiled, noise, parameters=bounded),
    ):
        values = series(found)["parameters"].values[:, -2]
        assert values.min() == 11.0
        count = np.count_nonzero(values == 11.0)
        assert f"g was put back on its bound at {count} samples" in found.safeguards


def test_joint_filter_is_the_plain_filter_of_the_stacked_model():
    compiled, noise, (recording,) = pendulum_case(5, lengths=(40,), missing=0.2)
    found = series(joint([recording], compiled, noise, parameter_noise=1e-5, alpha=0.6, beta=1.0, kappa=0.5))
    stacked = compile_model(stack_parameters(Pendulum(), FREE.names))
    P0 = np.zeros((4, 4))
    P0[:2, :2], P0[2:, 2:] = noise.P0, np.diag([1.0, 0.1])
    prior = replace(noise, m0=np.array([[*noise.m0[0], *FREE.start]]), P0=P0)
    added = np.diag([0.0, 0.0, 1e-5, 1e-5])
    plain = square_root_unscented_filter(stacked, recording, prior, unscented(4, 0.6, 1.0, 0.5), added=added)
    assert np.array_equal(np.hstack((found["states"].values, found["parameters"].values)), plain.m_filt)


def test_joint_filter_goes_on_from_test_to_test():
    compiled, noise, recordings = pendulum_case(6, lengths=(40, 30))
    filter_ = JointFilter(Pendulum(), compiled, noise, FREE, JointOptions(COVARIANCE, dict.fromkeys(COVARIANCE, 1e-6)))
    for k in range(40):
        filter_.step(recordings[0].y[k], recordings[0].u[k], 0.05)
    theta, std, loglik = filter_.theta, filter_.theta_std, filter_.loglik
    filter_.restart(1)
    assert np.array_equal(filter_.theta, theta)
    assert filter_.theta_std == pytest.approx(std, rel=1e-12)
    assert filter_.loglik == loglik
    filter_.step(recordings[1].y[0], recordings[1].u[0])
    assert filter_.loglik != loglik


def test_what_the_joint_filter_cannot_do_is_refused():
    compiled, noise, recordings = pendulum_case(0)
    with pytest.raises(EstimationError, match="estimates parameters of the model"):
        joint(recordings, compiled, noise, parameters=ParameterUnknowns())
    with pytest.raises(EstimationError, match="parameter_noise has no entry for c"):
        JointFilter(Pendulum(), compiled, noise, FREE, JointOptions(COVARIANCE, {"g": 0.0}))
