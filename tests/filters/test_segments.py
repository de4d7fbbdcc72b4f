"""Smoothing in segments gives the numbers of smoothing at once."""

import numpy as np
import pytest
from random_models import random_case

from noiseid_cli.estimators import em_statistics
from noiseid_cli.estimators.em_statistics import FILTERED, SMOOTHED, e_step
from noiseid_cli.filters import segments
from noiseid_cli.filters.ekf import FilterDivergedError
from noiseid_cli.filters.segments import forward_parts, segment_length
from noiseid_cli.filters.smoother import extended_kalman_smoother
from noiseid_cli.models.linear import linear_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording


def room_for(model, samples):
    """Bytes in which so many samples fit."""
    return next(room for room in range(8, 10**6, 8) if segment_length(model, room) == samples and room >= 8 * samples)


@pytest.mark.parametrize("length", [1, 2, 5, 7, 11, 12])
def test_parts_put_together_are_the_whole_to_the_last_bit(length):
    """13 samples in parts of each length, also where the last part is a single step."""
    case = random_case(4, 3, 2, 3, lengths=(13,), missing=0.3)
    recording = case.recordings[0]
    (whole,) = forward_parts(case.model, recording, case.noise, 0)
    expected = extended_kalman_smoother(whole.forward)
    end, m, U, loglik, count = None, expected.m[-1:], expected.U[-1:], 0.0, 0
    for part in forward_parts(case.model, recording, case.noise, 0, room_for(case.model, length)):
        found = extended_kalman_smoother(part.forward, end)
        end = found.m[0], found.U[0]
        m, U = np.concatenate([found.m[:-1], m]), np.concatenate([found.U[:-1], U])
        loglik, count = loglik + part.forward.loglik, count + 1
    assert count == -(-12 // length)
    assert np.array_equal(m, expected.m)
    assert np.array_equal(U, expected.U)
    assert loglik == pytest.approx(whole.forward.loglik, rel=1e-13)


@pytest.mark.parametrize("linearisation", [SMOOTHED, FILTERED])
def test_statistics_in_segments_are_those_of_the_whole(linearisation, monkeypatch):
    case = random_case(5, 3, 2, 3, lengths=(13, 8), missing=0.3)
    blocks = np.zeros(3, dtype=np.int64)
    whole = e_step(case.model, case.recordings, case.noise, linearisation, blocks)
    room = room_for(case.model, 4)
    monkeypatch.setattr(em_statistics, "forward_parts", lambda *a: segments.forward_parts(*a, room))
    parts = e_step(case.model, case.recordings, case.noise, linearisation, blocks)
    assert parts.steps == whole.steps
    assert np.array_equal(parts.samples, whole.samples)
    assert np.array_equal(parts.m_first, whole.m_first)
    np.testing.assert_allclose(parts.moment_v, whole.moment_v, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(parts.moment_e, whole.moment_e, rtol=1e-12, atol=1e-13)


def test_a_failure_is_told_with_its_place_in_the_test():
    model = linear_model(A=[[1e40]], G=[[1.0]], C=[[1.0]])
    recording = Recording("wild", np.ones(19), np.zeros((20, 0)), np.full((20, 1), np.nan))
    noise = NoiseValues(np.eye(1), np.eye(1), np.ones((1, 1)), np.eye(1))
    with pytest.raises(FilterDivergedError) as whole:
        list(forward_parts(model, recording, noise, 0))
    with pytest.raises(FilterDivergedError) as parts:
        list(forward_parts(model, recording, noise, 0, room_for(model, 3)))
    assert str(parts.value) == str(whole.value)
