"""Direct maximum likelihood: the dense Gaussian's maximum, EM's maximum, bounds, ties, errors, false ends, profiles."""

from dataclasses import replace

import numpy as np
import pytest
from dense_gaussian import dense_posterior
from pendulum import pendulum_case
from random_models import random_case

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators import em, ml
from noiseid_cli.estimators.ml import MlOptions
from noiseid_cli.estimators.profile_likelihood import Profile
from noiseid_cli.estimators.structure import CovarianceStructure
from noiseid_cli.estimators.unknowns import ParameterUnknowns, Unknowns
from noiseid_cli.filters.ekf import extended_kalman_filter
from noiseid_cli.models.linear import linear_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording


def problem(seed, lengths=(300, 200), missing=0.1):
    """A linear case with a start far from what made the data: full Q, diagonal R."""
    case = random_case(seed, 2, 1, 2, lengths=lengths, missing=missing)
    start = replace(case.noise, Q=case.noise.Q * 30, R=np.diag(np.diag(case.noise.R)) / 10)
    unknowns = Unknowns(Q=CovarianceStructure.full(start.Q, "Q"), R=CovarianceStructure.diagonal(start.R, "R"))
    return case, start, unknowns


def declared(model):
    return tuple((f"p{i}", "m", f"entry {i}") for i in range(model.parameters.size))


def free(model, places, factor=1.0, lower=-np.inf, upper=np.inf):
    """These parameters of the model as unknowns."""
    size = len(places)
    return ParameterUnknowns(
        tuple(f"p{i}" for i in places),
        model.parameters[list(places)] * factor,
        np.full(size, lower),
        np.full(size, upper),
    )


def test_end_is_a_maximum_of_the_dense_gaussian():
    """Slopes by every unknown entry and by a parameter, on the joint Gaussian of 25 samples."""
    case, start, unknowns = problem(4, lengths=(25,), missing=0.15)
    found = ml.estimate(case.model, case.recordings, start, unknowns, free(case.model, [0]), declared(case.model))
    assert found.status == "converged"
    a = found.parameters.final[0]

    def value(q, r1, r2, a):
        A = case.A.copy()
        A[0, 0] = a
        n = found.final
        args = (A, case.B, case.G, case.C, case.D, case.recordings[0])
        return dense_posterior(*args, np.array([[q]]), np.diag([r1, r2]), n.m0[0], n.P0)[2]

    at = np.array([found.final.Q[0, 0], *np.diag(found.final.R), a])
    assert value(*at) == pytest.approx(found.loglik, abs=1e-9)
    for i in range(4):
        h = 1e-4 * at[i] * np.eye(4)[i]
        slope = (8 * (value(*(at + h)) - value(*(at - h))) - (value(*(at + 2 * h)) - value(*(at - 2 * h)))) / 12e-4
        assert abs(slope) < 1e-6


@pytest.mark.parametrize("gradient", ["exact", "differences"])
def test_ml_and_em_meet_at_one_maximum(gradient):
    case, start, unknowns = problem(1)
    options = em.EmOptions(linearisation="filtered", parameter_tolerance=1e-9, loglik_tolerance=1e-10, max_passes=3000)
    theirs = em.estimate(case.model, case.recordings, start, unknowns, options)
    ours = ml.estimate(case.model, case.recordings, start, unknowns, options=MlOptions(gradient=gradient, em_passes=0))
    assert (ours.status, theirs.status) == ("converged", "converged")
    assert ours.loglik == pytest.approx(theirs.loglik, abs=1e-7)
    np.testing.assert_allclose(ours.final.Q, theirs.final.Q, rtol=1e-6)
    np.testing.assert_allclose(np.diag(ours.final.R), np.diag(theirs.final.R), rtol=1e-6)
    assert ours.settings["gradient"] == gradient
    assert np.max(ours.trace["loglik"]) == pytest.approx(ours.loglik, abs=1e-6)


def test_end_of_ml_is_a_fixed_point_of_em():
    """All at once: Q, R, P0 and the common initial mean, over tests that share them."""
    case, start, unknowns = problem(2, lengths=(40,) * 12)
    start = replace(start, m0=np.zeros((12, 2)), P0=2.0 * np.eye(2))
    unknowns = replace(unknowns, m0=True, P0=CovarianceStructure.full(start.P0, "P0"))
    ours = ml.estimate(case.model, case.recordings, start, unknowns)
    assert ours.status == "converged"
    step = em.estimate(
        case.model, case.recordings, ours.final, unknowns, em.EmOptions(linearisation="filtered", max_passes=1)
    )
    assert step.trace["change"][0] < 1e-5


def test_tied_variances_end_equal_and_at_the_maximum_among_equals():
    case, start, _ = problem(0)
    start = replace(start, R=np.eye(2))
    tied = CovarianceStructure(start.R, ((0,), (1,)), tied=((0, 1),), what="R")
    unknowns = Unknowns(Q=CovarianceStructure.full(start.Q, "Q"), R=tied)
    ours = ml.estimate(case.model, case.recordings, start, unknowns)
    scaled = ml.estimate(
        case.model, case.recordings, start, replace(unknowns, R=CovarianceStructure.scaled(start.R, "R"))
    )
    assert ours.final.R[0, 0] == ours.final.R[1, 1]
    # A factor on the unit matrix is the same set of covariances.
    np.testing.assert_allclose(ours.final.R, scaled.final.R, rtol=1e-6)
    assert ours.loglik == pytest.approx(scaled.loglik, abs=1e-7)


def test_parameters_of_a_nonlinear_model_with_their_errors():
    """Damping and gravity of a pendulum: the truth within four standard errors, and the errors are no wild guess."""
    model, noise, recordings = pendulum_case(7, (250, 200))
    start = replace(noise, Q=noise.Q * 10, R=noise.R * 5)
    unknowns = Unknowns(Q=CovarianceStructure.full(start.Q), R=CovarianceStructure.diagonal(start.R))
    parameters = free(model, [0, 1], 1.3, lower=0.0)
    found = ml.estimate(model, recordings, start, unknowns, parameters, declared(model))
    assert found.status == "converged"
    p = found.parameters
    assert p.names == (("p0", "m", "entry 0"), ("p1", "m", "entry 1"))
    assert np.all(np.abs(p.final - model.parameters) < 4 * p.standard_errors)
    assert np.all(p.standard_errors < 0.2 * model.parameters)
    truth = sum(extended_kalman_filter(model, r, noise, i).loglik for i, r in enumerate(recordings))
    # Twice the gain over the truth is chi-square with 5 degrees of freedom: beyond 25 once in 7000.
    assert 0.0 < 2.0 * (found.loglik - truth) < 25.0


def test_standard_errors_are_those_of_the_exact_fisher_information():
    """A constant in white noise, known start: the slope's error is sqrt(r / sum of squares), over 60 realisations."""
    N, r, errors, ends = 60, 0.25, [], []
    u = np.ones((N, 1))
    exact = np.sqrt(r / N)
    for seed in range(60):
        rng = np.random.default_rng(seed)
        y = 2.0 * u + np.sqrt(r) * rng.normal(size=(N, 1))
        model = linear_model(A=[[0.0]], G=[[1.0]], C=[[1.0]], B=[[0.0]], D=[[1.0]])
        noise = NoiseValues(np.zeros((1, 1)), np.array([[r]]), np.zeros((1, 1)), np.zeros((1, 1)))
        recording = Recording("a", np.ones(N - 1), u, y)
        last = model.parameters.size - 1
        parameters = free(model, [last])
        found = ml.estimate(model, [recording], noise, Unknowns(), parameters, declared(model))
        errors.append(found.parameters.standard_errors[0])
        ends.append(found.parameters.final[0])
    np.testing.assert_allclose(errors, exact, rtol=1e-6)
    # The scatter of 60 ends about the truth: chi-square, standard deviation sqrt(2 / 60) of its mean.
    assert np.mean(np.square((np.array(ends) - 2.0) / exact)) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 60))


def test_a_parameter_that_runs_to_its_bound_is_said_to():
    case, start, unknowns = problem(1)
    above = float(case.model.parameters[1]) + 2.0
    parameters = ParameterUnknowns(("p1",), np.array([above + 1.0]), np.array([above]), np.array([np.inf]))
    found = ml.estimate(case.model, case.recordings, start, unknowns, parameters, declared(case.model))
    assert found.parameters.final[0] == pytest.approx(above, abs=1e-4)
    assert found.parameters.final[0] >= above
    assert np.isnan(found.parameters.standard_errors[0])
    assert any("p1 has run to its lower bound" in s for s in found.safeguards)


def local_level(seed=0):
    rng = np.random.default_rng(seed)
    y = np.cumsum(0.3 * rng.normal(size=400)) + rng.normal(size=400)
    model = linear_model(A=[[1.0]], G=[[1.0]], C=[[1.0]])
    return model, [Recording("a", np.ones(399), np.zeros((400, 0)), y[:, None])]


def test_em_passes_cure_a_false_end():
    """From Q and R far too small the climb alone ends with R at zero, and says so; after passes of EM it does not."""
    model, recordings = local_level()
    start = NoiseValues(np.array([[1e-6]]), np.array([[1e-8]]), np.zeros((1, 1)), np.eye(1))
    unknowns = Unknowns(Q=CovarianceStructure.full(start.Q, "Q"), R=CovarianceStructure.full(start.R, "R"))
    alone = ml.estimate(model, recordings, start, unknowns, options=MlOptions(em_passes=0))
    helped = ml.estimate(model, recordings, start, unknowns)
    assert alone.status == "stalled_fixed_point"
    assert "take more em_passes" in alone.reason
    assert helped.status == "converged"
    assert helped.loglik > alone.loglik + 10.0


def test_profile_is_the_maximum_over_the_rest():
    case, start, unknowns = problem(1)
    options = MlOptions(profile=Profile("p0", points=5, span=2.0))
    found = ml.estimate(
        case.model, case.recordings, start, unknowns, free(case.model, [0]), declared(case.model), options
    )
    (series,) = found.series
    assert series.at.shape == (5,)
    assert np.all(np.diff(series.at) > 0)
    assert np.max(series.values[:, 0]) == 0.0
    error = found.parameters.standard_errors[0]
    np.testing.assert_allclose(series.at[[0, -1]], found.parameters.final[0] + np.array([-2, 2]) * error, rtol=1e-9)
    np.testing.assert_allclose(series.values[:, 1], [-2.0, -0.5, 0.0, -0.5, -2.0], atol=1e-12)
    # Held there, everything else finds the same height.
    vector = case.model.parameters.copy()
    vector[0] = series.at[-1]
    held = ml.estimate(replace(case.model, parameters=vector), case.recordings, start, unknowns)
    assert held.loglik - found.loglik == pytest.approx(series.values[-1, 0], abs=1e-3)


def test_profile_of_a_standard_deviation_inside_a_block():
    case = random_case(5, 2, 2, 2, lengths=(300,), missing=0.0)
    unknowns = Unknowns(Q=CovarianceStructure.full(case.noise.Q, "Q"))
    options = MlOptions(profile=Profile("v2", points=3, span=1.0))
    found = ml.estimate(case.model, case.recordings, case.noise, unknowns, options=options)
    (series,) = found.series
    assert series.at[1] == pytest.approx(np.sqrt(found.final.Q[1, 1]))
    assert np.all(series.values[[0, 2], 0] < -0.2)
    assert "standard deviation of v2" in series.title


def test_what_cannot_be_posed_is_refused():
    case, start, unknowns = problem(1)
    with pytest.raises(EstimationError, match="profile: nobody is not an unknown; there are: v1, y1, y2"):
        ml.estimate(case.model, case.recordings, start, unknowns, options=MlOptions(profile=Profile("nobody")))
    with pytest.raises(EstimationError, match="p0 is not a parameter of linear: none is declared"):
        ml.estimate(case.model, case.recordings, start, unknowns, free(case.model, [0]))
    with pytest.raises(EstimationError, match="nothing is unknown"):
        ml.estimate(case.model, case.recordings, start, Unknowns())


def test_passes_may_run_out():
    case, start, unknowns = problem(1)
    found = ml.estimate(case.model, case.recordings, start, unknowns, options=MlOptions(max_passes=10))
    assert found.status == "max_passes"


def test_differences_take_the_place_of_a_missing_adjoint():
    case, start, unknowns = problem(1)
    model = replace(case.model, load_adjoints=None)
    found = ml.estimate(model, case.recordings, start, unknowns)
    assert found.status == "converged"
    assert any("central differences took its place" in s for s in found.safeguards)


def test_em_leads_on_from_an_end_that_is_no_top(monkeypatch):
    """A climb that stops short, as on a tooth of a jagged likelihood, is taken up by EM, and said."""
    case, start, unknowns = problem(1)
    whole = ml.estimate(case.model, case.recordings, start, unknowns)
    search, ends = ml.search, []

    def short(*given):
        end = search(*given)
        if not ends:
            point = given[0].point(end.climb.point.z + 0.3)
            end = replace(end, climb=replace(end.climb, point=point))
        ends.append(end.climb.point.loglik)
        return end

    monkeypatch.setattr(ml, "search", short)
    found = ml.estimate(case.model, case.recordings, start, unknowns)
    assert len(ends) == 2
    assert found.status == "converged"
    assert found.loglik == pytest.approx(whole.loglik, abs=1e-6)
    gain = found.loglik - ends[0]
    assert gain > 1.0
    assert any(
        f"once the climb ended on a tooth, from which EM led on, to {gain:.3g} more" in s for s in found.safeguards
    )
    assert not any("tooth" in s for s in whole.safeguards)
    ends.clear()
    alone = ml.estimate(case.model, case.recordings, start, unknowns, options=MlOptions(em_passes=0))
    assert alone.loglik == ends[0] < found.loglik - 1.0
