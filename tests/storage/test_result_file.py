"""Result files: exact round trips and how xarray shows them."""

from dataclasses import fields, replace

import numpy as np
import pytest
import xarray
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from noiseid_cli.diagnostics.evaluation import Evaluation
from noiseid_cli.diagnostics.where import Misfit
from noiseid_cli.errors import DataError
from noiseid_cli.estimators.estimate import Estimate, NoiseValues, Parameters, Series, Uncertainty
from noiseid_cli.outcome import UnitResult
from noiseid_cli.storage.provenance import provenance
from noiseid_cli.storage.result_file import read_result, read_result_attributes, write_result

any_float = st.floats(allow_nan=True, allow_infinity=True, allow_subnormal=True)


def assert_same(a, b):
    """Equality to the bit of anything that a result is made of."""
    assert type(a) is type(b)
    if isinstance(a, np.ndarray):
        assert a.shape == b.shape
        assert a.dtype == b.dtype
        assert a.tobytes() == b.tobytes()
    elif isinstance(a, float):
        assert np.float64(a).tobytes() == np.float64(b).tobytes()
    elif hasattr(a, "__dataclass_fields__"):
        for field in fields(a):
            assert_same(getattr(a, field.name), getattr(b, field.name))
    elif isinstance(a, dict):
        assert list(a) == list(b)
        for name in a:
            assert_same(a[name], b[name])
    elif isinstance(a, tuple):
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            assert_same(x, y)
    else:
        assert a == b


@st.composite
def results(draw):
    nv, ny, nx, tests, lags, n, passes = (draw(st.integers(low, 3)) for low in (1, 1, 1, 1, 0, 0, 0))
    part = lambda *shape: draw(arrays(np.float64, shape, elements=any_float))  # noqa: E731
    number = lambda: draw(any_float)  # noqa: E731

    def noise():
        return NoiseValues(part(nv, nv), part(ny, ny), part(tests, nx), part(nx, nx))

    def evaluation(label):
        path = part(n) if draw(st.booleans()) else None
        figures = (part(ny), part(lags, ny), part(ny), part(ny))
        more = {"inside": part(ny), "normality": part(ny), "nees": number(), "nees_time": part(n), "states": nx}
        ranges = Misfit("speed", "rad/s", part(3), part(2), part(2))
        more = more | {"misfit": (ranges,) * draw(st.integers(0, 2))} if draw(st.booleans()) else {}
        return Evaluation(label, number(), n * ny, number(), *figures, path, number(), part(n), **more)

    trace = {"loglik": part(passes), "Q": part(passes, nv, nv), "R": part(passes, ny, ny), "change": part(passes)}
    estimate = Estimate(
        "em", "max_passes", "it stopped: Δ", noise(), noise(), number(), number(), passes, number(),
        trace if draw(st.booleans()) else {"other": part(2, 5), "odd": part(3)},
        ("one acted",), {"acceleration": "none", "tolerance": 1e-6, "max_passes": 7, "cap": float("inf")},
    )  # fmt: skip
    count = draw(st.integers(0, 2))
    unknowns = tuple((f"p{k}", "", "") for k in range(count))
    series = Series("p", "over tests", ("test", ""), part(n), unknowns, part(n, count))
    parameters = Parameters(
        unknowns,
        part(count),
        part(count),
        part(count) if draw(st.booleans()) else None,
        draw(st.sampled_from([(), (True, False)[:count]])),
    )
    estimate = replace(estimate, series=(series,) * draw(st.integers(0, 1)))
    if draw(st.booleans()):
        state = {"count": np.array(7), "scheme": np.array("literal"), "J": part(2, 3), "seen": np.arange(3)}
        estimate = replace(estimate, parameters=parameters, state=state)
    truth = part(count) if estimate.parameters is not None and draw(st.booleans()) else None
    d = draw(st.integers(0, 2))
    coordinates = tuple(f"Q v{k}" for k in range(d))
    figures = tuple(("process_noise_std", f"v{k}", "N m") for k in range(count))
    sure = Uncertainty(
        "score", 0.95, figures, part(count), part(count), part(count), part(count), ("of zero",) * count,
        coordinates, part(d, d), part(draw(st.integers(0, 2))), ("weak",), ("a ridge",),
    )  # fmt: skip
    columns = lambda letter, size: tuple((f"{letter}{k}", "N m", "a torque") for k in range(size))  # noqa: E731
    return UnitResult(
        "replicate-000/em/start-0", "demo", "em-plain", 1, "× 0.01", 3, estimate,
        {label: evaluation(label) for label in ("start", "estimate", "truth")},
        columns("v", nv), columns("y", ny), columns("x", nx), tuple(f"test-{k}" for k in range(tests)),
        part(nv, nv) if draw(st.booleans()) else None, part(ny, ny) if draw(st.booleans()) else None,
        12.5, 2**127 + 1,
        {label: evaluation(label) for label in ("start", "estimate") if draw(st.booleans())}, 3, truth,
        uncertainty=sure if draw(st.booleans()) else None,
        Q_tuning=part(nv, nv) if draw(st.booleans()) else None,
        R_tuning=part(ny, ny) if draw(st.booleans()) else None,
    )  # fmt: skip


@settings(max_examples=40)
@given(result=results())
def test_round_trip_is_exact_to_the_bit(tmp_path, result):
    write_result(tmp_path / "r.h5", result, {"key": "abc"})
    assert_same(read_result(tmp_path / "r.h5"), result)
    assert read_result_attributes(tmp_path / "r.h5")["key"] == "abc"


def example(n=1000, passes=5):
    noise = NoiseValues(np.eye(2), np.eye(1), np.zeros((1, 3)), np.eye(3))
    trace = {
        "loglik": np.arange(passes, dtype=float),
        "Q": np.ones((passes, 2, 2)),
        "R": np.ones((passes, 1, 1)),
        "accepted": np.ones(passes),
    }
    estimate = Estimate("em", "converged", "the step is small", noise, noise, -3.0, -1.0, passes, 0.5, trace)
    figures = (np.ones(1), np.zeros((20, 1)), np.ones(1), np.zeros(1))
    evaluation = Evaluation("estimate", -1.0, n, 1.01, *figures, np.ones(n), 2.0, np.ones(n))
    columns = {
        "noise_names": (("v1", "N m", "torque"), ("v2", "N m", "torque")),
        "output_names": (("q", "rad", "angle"),),
        "state_names": (("q", "rad", "angle"), ("dq", "rad/s", "speed"), ("b", "N m", "bias")),
    }
    return UnitResult(
        "replicate-000/em/start-0", "demo", "em", 0, "× 1", 0, estimate, {"estimate": evaluation}, **columns,
        test_names=("a",), Q_true=np.eye(2), R_true=None, seconds=1.0, seed=1,
    )  # fmt: skip


def test_xarray_shows_names_and_units(tmp_path):
    path = tmp_path / "r.h5"
    write_result(path, example(), {})
    with xarray.open_datatree(path) as tree:
        assert tree["trace/Q"].dims == ("pass", "noise", "noise_")
        assert tree["trace/Q"].sizes["pass"] == 5
        assert tree["final/m0"].dims == ("test", "state")
        assert list(tree["noise"].values) == ["v1", "v2"]
        assert list(tree["state_unit"].values) == ["rad", "rad/s", "N m"]
        assert tree["evaluation/estimate/autocorrelation"].dims == ("lag", "output")
        assert tree["evaluation/estimate/lag"].values[0] == 1
        assert tree.attrs["status"] == "converged"
        assert float(tree["loglik"]) == -1.0
    with xarray.open_dataset(path, group="final") as final:
        assert final["Q"].attrs["units"]


def test_arrays_that_contradict_the_names_are_refused(tmp_path):
    with pytest.raises(DataError, match="'Q' has 2 entries along 'noise', which names 1"):
        write_result(tmp_path / "r.h5", replace(example(), noise_names=(("v1", "", ""),)), {})
    with pytest.raises(DataError, match="cannot be labelled 'a/b'"):
        write_result(tmp_path / "r.h5", replace(example(), evaluations={"a/b": None}), {})
    with pytest.raises(DataError, match="'status' belongs to the file format"):
        write_result(tmp_path / "r.h5", example(), {"status": "converged"})


def test_provenance_changes_only_with_the_callers_time():
    assert provenance() == provenance()
    assert provenance("2026-01-01T00:00:00Z") == provenance() | {"time": "2026-01-01T00:00:00Z"}
    assert {"noiseid", "python", "numpy", "scipy", "numba", "sympy", "h5py", "cpu", "blas"} <= set(provenance())
    assert all(provenance().values())
