"""The exact gradient of the filter's log-likelihood against differences of the dense Gaussian and of the filter."""

from dataclasses import replace

import numpy as np
import pytest
from dense_gaussian import dense_posterior
from pendulum import pendulum_case
from random_models import random_case

from noiseid_cli.filters.ekf import extended_kalman_filter
from noiseid_cli.filters.ekf_adjoint import has_exact_gradient, loglik_gradient
from noiseid_cli.models.schemes import DENSITY, DISCRETE, EULER, EXACT, RK4


def directions(noise, rng):
    """Random symmetric changes of each covariance and of the mean, small against them."""
    out = {}
    for name in ("Q", "R", "P0"):
        A = getattr(noise, name)
        s = np.sqrt(np.diag(A))
        E = rng.normal(size=A.shape)
        out[name] = (E + E.T) * np.outer(s, s)
    out["m0"] = rng.normal(size=noise.m0.shape) * np.sqrt(np.diag(noise.P0))
    return out


def dense_slope(case, recording, change, step):
    """Central difference of the dense Gaussian's log-likelihood along changes of the noise."""
    values = []
    for sign in (1.0, -1.0):
        n = {name: getattr(case.noise, name) + sign * step * d for name, d in change.items()}
        args = (case.A, case.B, case.G, case.C, case.D, recording, n["Q"], n["R"], n["m0"][0], n["P0"])
        values.append(dense_posterior(*args)[2])
    return (values[0] - values[1]) / (2.0 * step)


@pytest.mark.parametrize("seed", range(4))
def test_gradient_by_the_noise_is_that_of_the_dense_gaussian(seed):
    """Missing outputs included; one direction for each covariance and the mean."""
    case = random_case(seed, 3, 2, 2, lengths=(12,), missing=0.25)
    recording = case.recordings[0]
    filtered = extended_kalman_filter(case.model, recording, case.noise)
    gradient = loglik_gradient(case.model, recording, filtered, case.noise.Q)
    for name, d in directions(case.noise, np.random.default_rng(seed)).items():
        found = float(np.sum(np.reshape(getattr(gradient, name), d.shape) * d))
        # Richardson's combination of two central differences: error of the order of step^4.
        expected = (4 * dense_slope(case, recording, {**whole(case), name: d}, 1e-3)
                    - dense_slope(case, recording, {**whole(case), name: d}, 2e-3)) / 3  # fmt: skip
        assert found == pytest.approx(expected, rel=1e-7, abs=1e-7)


def whole(case):
    """No change of anything."""
    return {name: np.zeros_like(getattr(case.noise, name)) for name in ("Q", "R", "P0", "m0")}


def slopes(model, recording, noise, change, by, step=1e-4):
    """Central difference of the filter's log-likelihood along one change of noise or parameters."""

    def value(h):
        if by == "parameters":
            return extended_kalman_filter(replace(model, parameters=model.parameters + h * change), recording, noise)
        return extended_kalman_filter(model, recording, replace(noise, **{by: getattr(noise, by) + h * change}))

    return (8 * (value(step).loglik - value(-step).loglik) - (value(2 * step).loglik - value(-2 * step).loglik)) / (
        12 * step
    )


@pytest.mark.parametrize("scheme", [EULER, RK4, EULER + DENSITY, RK4 + DENSITY])
def test_gradient_goes_through_the_linearisation_points(scheme):
    """A pendulum with a state-dependent noise gain, each scheme, parameters too."""
    model, noise, recordings = pendulum_case(3, (30,), missing=0.2)
    model = replace(model, scheme=scheme)
    filtered = extended_kalman_filter(model, recordings[0], noise)
    gradient = loglik_gradient(model, recordings[0], filtered, noise.Q)
    changes = directions(noise, np.random.default_rng(1)) | {"parameters": np.array([0.3, -2.0])}
    for by, d in changes.items():
        found = float(np.sum(np.reshape(getattr(gradient, by), d.shape) * d))
        assert found == pytest.approx(slopes(model, recordings[0], noise, d, by), rel=1e-6)


@pytest.mark.parametrize("scheme", [DISCRETE, EXACT, EXACT + DENSITY])
def test_gradient_by_every_entry_of_a_linear_model(scheme):
    """A, B, G, C and D travel as parameters: each has its slope; intervals differ, states have units of their own."""
    case = random_case(11, 2, 1, 2, lengths=(15,), missing=0.2)
    recording = case.recordings[0]
    model = case.model
    if scheme != DISCRETE:
        # A rate of 1 and one of 30 per interval: both few and many doublings, and balancing.
        rates = case.A.copy() * np.array([[1.0, 1e3], [1e-3, 1.0]]) - np.diag([0.2, 30.0])
        model = replace(model, scheme=scheme, parameters=np.concatenate([rates.ravel(), model.parameters[4:]]))
        recording = replace(recording, dt=np.random.default_rng(0).uniform(0.01, 1.5, size=14))
    gradient = loglik_gradient(
        model, recording, extended_kalman_filter(model, recording, case.noise), case.noise.Q
    ).parameters
    for i in range(model.parameters.size):
        e = np.eye(model.parameters.size)[i]
        slope = slopes(model, recording, case.noise, e, "parameters")
        assert gradient[i] == pytest.approx(slope, rel=1e-6, abs=1e-8 * np.max(np.abs(gradient)))


def test_a_model_without_adjoints_has_no_exact_gradient():
    model = random_case(0).model
    assert has_exact_gradient(model)
    assert not has_exact_gradient(replace(model, load_adjoints=None))
    assert not has_exact_gradient(replace(model, scheme=99))
