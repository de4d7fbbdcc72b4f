"""The process noise per sample and as a density: the same estimate, in both units, on equal and unequal intervals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from small_experiment import CONFIG, write_experiment

from noiseid_cli.errors import ConfigError
from noiseid_cli.estimators import em
from noiseid_cli.estimators.structure import CovarianceStructure
from noiseid_cli.estimators.unknowns import Unknowns
from noiseid_cli.filters.ekf import extended_kalman_filter
from noiseid_cli.models import Model, Quantity
from noiseid_cli.models.compile import compile_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording
from noiseid_cli.models.schemes import DENSITY
from noiseid_cli.pipeline.context import open_experiment
from noiseid_cli.pipeline.datasets import make_dataset
from noiseid_cli.pipeline.estimation import make_estimate
from noiseid_cli.pipeline.noise_unit import conversion_interval
from noiseid_cli.pipeline.units import dataset_units, estimate_units
from noiseid_cli.storage.dataset_file import read_dataset
from noiseid_cli.storage.result_file import read_result

ROOT_DT = 0.1  # of the cart's interval of 0.01 s


class Wiener(Model):
    """A position pushed about by white noise."""

    name = "wiener"
    states = (Quantity("x", "m"),)
    noises = (Quantity("v", "m/s"),)
    outputs = (Quantity("y", "m"),)
    sample_time = 1.0
    discretisation = "exact"

    def dynamics(self, x, u, v, p):
        return [v.v]

    def output(self, x, u, p):
        return [x.x]


@pytest.fixture(scope="module")
def wiener():
    model = compile_model(Wiener())
    return replace(model, scheme=model.scheme + DENSITY)


def unequal(seed, samples):
    rng = np.random.default_rng(seed)
    dt = rng.uniform(0.1, 3.0, size=samples - 1)
    x = np.concatenate(([0.0], np.cumsum(np.sqrt(0.7 * dt) * rng.normal(size=samples - 1))))
    return Recording("test", dt, np.zeros((samples, 0)), (x + 0.5 * rng.normal(size=samples))[:, None])


def test_a_density_on_unequal_intervals_is_the_wiener_process(wiener):
    """Cov(y_i, y_j) = P0 + S min(t_i, t_j) + R where i = j, whatever the intervals."""
    recording = unequal(1, 12)
    noise = NoiseValues(Q=np.array([[0.7]]), R=np.array([[0.25]]), m0=np.zeros((1, 1)), P0=np.array([[2.0]]))
    t = recording.time
    covariance = 2.0 + 0.7 * np.minimum(t[:, None], t[None, :]) + 0.25 * np.eye(12)
    expected = multivariate_normal(np.zeros(12), covariance).logpdf(recording.y[:, 0])
    assert extended_kalman_filter(wiener, recording, noise).loglik == pytest.approx(expected, rel=1e-12)


def test_em_finds_the_density_on_unequal_intervals_where_one_q_per_sample_is_wrong(wiener):
    """The greatest likelihood over the density is EM's end, and lies above that over one Q for all intervals."""
    recording = unequal(2, 400)
    start = NoiseValues(Q=np.array([[2.0]]), R=np.array([[0.25]]), m0=np.zeros((1, 1)), P0=np.zeros((1, 1)))
    ends = {}
    for scheme in (wiener.scheme, wiener.scheme - DENSITY):
        model = replace(wiener, scheme=scheme)
        options = em.EmOptions(parameter_tolerance=1e-8, loglik_tolerance=1e-8)
        end = em.estimate(model, [recording], start, Unknowns(Q=CovarianceStructure.full(start.Q)), options)
        assert end.status == "converged"
        around = [replace(end.final, Q=end.final.Q * f) for f in (0.99, 1.01)]
        assert all(extended_kalman_filter(model, recording, noise).loglik < end.loglik for noise in around)
        ends[scheme] = end
    density, per_sample = ends[wiener.scheme], ends[wiener.scheme - DENSITY]
    assert density.loglik > per_sample.loglik + 5
    # The relative error of a variance from 399 increments is at least sqrt(2 / 399) = 0.07; five times that.
    assert density.final.Q[0, 0] == pytest.approx(0.7, rel=0.35)


def made(folder, config):
    folder.mkdir()
    context = open_experiment(write_experiment(folder, config), folder / "runs")
    make_dataset(context, dataset_units(context)[0])
    unit = estimate_units(context)[0]
    make_estimate(context, unit)
    return context, unit, read_result(unit.path)


def test_both_units_give_the_same_data_and_the_same_estimate(tmp_path):
    as_density = CONFIG.replace("process_noise: {std: [0.5]}", "process_noise: {std: [0.05], unit: density}")
    as_density = as_density.replace("{start: {std: [1]}}", "{start: {std: [0.1], unit: density}}")
    context, unit, sampled = made(tmp_path / "sample", CONFIG)
    other, other_unit, density = made(tmp_path / "density", as_density)
    data, other_data = read_dataset(unit.dataset.path), read_dataset(other_unit.dataset.path)
    np.testing.assert_allclose(data.recordings[0].y, other_data.recordings[0].y, rtol=1e-12)
    np.testing.assert_allclose(other_data.Q_true, data.Q_true, rtol=1e-14)
    assert (sampled.density, density.density) == (False, True)
    assert sampled.interval == density.interval == pytest.approx(0.01)
    assert (sampled.noise_names[0][1], density.noise_names[0][1]) == ("N", "N/√Hz")
    assert density.estimate.loglik == pytest.approx(sampled.estimate.loglik, rel=1e-9)
    for a, b in (
        (density.estimate.final.Q, sampled.estimate.final.Q),
        (density.estimate.start.Q, sampled.estimate.start.Q),
        (density.Q_true, sampled.Q_true),
    ):
        np.testing.assert_allclose(a, b * ROOT_DT**2, rtol=1e-6)
    assert density.evaluations["truth"].loglik == pytest.approx(sampled.evaluations["truth"].loglik, rel=1e-9)
    assert context.compiled.scheme == other.compiled.scheme - DENSITY == other.simulator.scheme


def test_what_converts_the_units(tmp_path):
    context = open_experiment(write_experiment(tmp_path), tmp_path / "runs")
    data = make_dataset(context, dataset_units(context)[0])
    dt = data.recordings[0].dt.copy()
    dt[5] *= 1.5
    uneven = replace(data, recordings=(replace(data.recordings[0], dt=dt),))
    assert conversion_interval(uneven, context.model, density=False) is None
    assert conversion_interval(uneven, context.model, density=True) == pytest.approx(0.01)
    discrete = context.model
    discrete.discretisation = "discrete"
    assert conversion_interval(data, discrete, density=False) is None


DISCRETE = '''
from noiseid_cli.models import Model, Quantity


class Cart(Model):
    """A level that wanders."""

    name = "cart"
    states = (Quantity("x"), Quantity("w"))
    inputs = (Quantity("f"),)
    noises = (Quantity("v"),)
    outputs = (Quantity("x"),)
    sample_time = 1.0
    discretisation = "discrete"

    def dynamics(self, x, u, v, p):
        return [x.x + v.v, x.w + u.f]

    def output(self, x, u, p):
        return [x.x]
'''


@pytest.mark.parametrize(
    ("old", "new", "path"),
    [
        ("process_noise: {std: [0.5]}", "process_noise: {std: [0.5], unit: density}", "simulate.process_noise.unit"),
        ("{start: {std: [1]}}", "{start: {std: [1], unit: density}}", "estimate.process_noise.start.unit"),
    ],
)
def test_a_density_is_refused_for_a_discrete_model(tmp_path, old, new, path):
    config = CONFIG.replace(old, new).replace("lowest: 1, highest: 5", "lowest: 0.1, highest: 0.4")
    file = write_experiment(tmp_path, config)
    (tmp_path / "cart.py").write_text(DISCRETE)
    with pytest.raises(ConfigError) as caught:
        open_experiment(file, tmp_path / "runs")
    (problem,) = caught.value.problems
    assert (problem.path, "take per_sample" in problem.message) == (path, True)
