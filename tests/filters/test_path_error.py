"""The path error against a loop over samples."""

from dataclasses import replace

import numpy as np
from pendulum import pendulum_case

from noiseid_cli.diagnostics.evaluate import evaluate
from noiseid_cli.filters.ekf import extended_kalman_filter
from noiseid_cli.filters.path_error import path_error, performance_error


def performing(seed=0, lengths=(50,)):
    """The pendulum with its outputs as performance outputs, and a made-up truth."""
    model, noise, recordings = pendulum_case(seed, lengths=lengths)
    model = replace(model, performances=("z1", "z2"), performance=model.output)
    rng = np.random.default_rng(seed)
    return model, noise, [replace(r, z_true=rng.normal(size=(r.samples, 2))) for r in recordings]


def test_equals_a_loop_over_samples():
    model, _, (recording,) = performing()
    m = np.asfortranarray(np.random.default_rng(1).normal(size=(50, 2)))
    expected, z = np.empty((50, 2)), np.empty(2)
    for k in range(50):
        model.performance(np.ascontiguousarray(m[k]), recording.u[k], model.parameters, z)
        expected[k] = z - recording.z_true[k]
    assert np.array_equal(performance_error(model, recording, m), expected)
    assert np.allclose(path_error(model, recording, m), [np.hypot(*e) for e in expected], rtol=1e-14)


def test_an_unknown_truth_is_nan_at_its_sample_only():
    model, _, (recording,) = performing()
    truth = recording.z_true.copy()
    truth[7, 1] = np.nan
    error = path_error(model, replace(recording, z_true=truth), np.zeros((50, 2)))
    assert np.flatnonzero(np.isnan(error)).tolist() == [7]


def test_evaluation_joins_the_tests():
    model, noise, recordings = performing(lengths=(50, 30))
    error = evaluate(model, recordings, noise, "truth").path_error
    filtered = [extended_kalman_filter(model, r, noise, i) for i, r in enumerate(recordings)]
    expected = [path_error(model, r, f.m_filt) for r, f in zip(recordings, filtered, strict=True)]
    assert np.array_equal(error, np.concatenate(expected))
