"""What a look at an unknown log finds: steps, noise, the time and its unit, roles of columns, faults."""

from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st

from noiseid_cli.errors import DataError
from noiseid_cli.recordings.matching import match_columns
from noiseid_cli.recordings.options import RecordingSource
from noiseid_cli.recordings.proposals import propose
from noiseid_cli.recordings.readers import list_columns
from noiseid_cli.recordings.roles import find_roles
from noiseid_cli.recordings.survey import high_frequency_std, quantisation_step, survey
from noiseid_cli.recordings.time_column import find_time

rng = np.random.default_rng(5)
N = 400
T = 0.01 * np.arange(N)
WAVE = np.sin(3 * T) + 1e-3 * rng.normal(size=N)
PUSH = np.repeat(rng.normal(size=N // 20), 20)


def looked_at(tmp_path, columns, name="log.csv"):
    """The survey of a CSV log with these columns; None stands for an empty cell."""
    file = tmp_path / name
    cells = [["" if v is None else v if isinstance(v, str) else repr(float(v)) for v in c] for c in columns.values()]
    file.write_text("\n".join([",".join(columns), *map(",".join, zip(*cells, strict=True))]) + "\n")
    return survey(RecordingSource("log", file))


def roles(found):
    return {role.key: role.role for role in find_roles(found, find_time(found))}


@given(st.floats(1e-6, 1e3), st.integers(2, 400), st.integers(0, 2**32))
@settings(max_examples=60)
def test_the_step_of_a_rounded_signal_is_found_to_nine_printed_digits(step, levels, seed):
    ticks = np.random.default_rng(seed).integers(-levels, levels, 500)
    ticks[:2] = 0, 1  # so that one step apart does occur
    values = np.array([float(f"{v:.9g}") for v in step * ticks])
    assert quantisation_step(values) == pytest.approx(step, rel=1e-4)


def test_what_is_not_rounded_has_no_step():
    assert quantisation_step(rng.normal(size=2000)) is None
    assert quantisation_step(np.full(10, 3.0)) is None
    assert quantisation_step(np.full(10, np.nan)) is None


@pytest.mark.parametrize("std", [1e-6, 0.3])
def test_the_noise_on_a_smooth_signal_is_found(std):
    n = 20_000
    t = 1e-3 * np.arange(n)
    found = high_frequency_std(np.sin(t) + std * np.random.default_rng(1).normal(size=n))
    # A median of n correlated values: its standard error is about 1.2 / sqrt(n) times sqrt(3.3), here 1.5 %.
    assert found == pytest.approx(std, rel=0.06)


def test_a_few_jumps_do_not_count_as_noise():
    values = np.where(np.arange(1000) < 500, 0.0, 100.0)
    assert high_frequency_std(values) == 0.0


@pytest.mark.parametrize(
    ("name", "factor", "start", "scale"),
    [
        ("t", 1.0, 0.0, 1.0),
        ("time_ms", 1e3, 5.0, 1e-3),
        ("Time [us]", 1e6, 0.0, 1e-6),
        ("stamp", 1e9, 1.7e18, 1e-9),
        ("timestamp", 1e3, 1.7e12, 1e-3),
        ("time", 1e3, 0.0, 1e-3),
        ("timeSec", 1.0, 0.0, 1.0),
    ],
)
def test_time_is_found_with_its_unit(tmp_path, name, factor, start, scale):
    found = looked_at(tmp_path, {"a": WAVE, name: start + np.round(factor * T, 3)})
    time = find_time(found)
    assert (time.key, time.scale) == (name, scale)
    assert time.interval == pytest.approx(0.01, rel=1e-6)
    assert (time.repeated, time.backward, time.gaps, time.unequal) == (0, 0, 0, 0)


def test_time_without_a_name_is_the_column_that_rises_evenly_and_no_counter(tmp_path):
    found = looked_at(tmp_path, {"row": np.arange(N), "sway": WAVE, "when": T + 2e-4 * rng.uniform(size=N)})
    assert find_time(found).key == "when"
    assert roles(found) == {"row": "left out", "sway": "output"}


def test_a_log_without_time_is_told_of_the_two_flags(tmp_path):
    found = looked_at(tmp_path, {"row": np.arange(N), "sway": WAVE})
    with pytest.raises(DataError, match=r"--time COLUMN.*--interval SECONDS"):
        find_time(found)
    assert find_time(found, interval=0.5).interval == 0.5
    assert find_time(found, wanted="row").key == "row"
    with pytest.raises(DataError, match="does not rise"):
        find_time(found, wanted="sway")


def test_what_no_clock_and_no_sensor_gives_is_refused(tmp_path):
    found = looked_at(tmp_path, {"t": 1e-300 * np.arange(N), "sway": WAVE})
    with pytest.raises(DataError, match=r"column 't' the rows are 1e-300 s apart, so it is no clock\. .*--time COLUMN"):
        find_time(found)
    with pytest.raises(DataError, match="1e-300 s between rows: expected 1e-15 to 1e"):
        find_time(found, interval=1e-300)
    with pytest.raises(DataError, match=r"line 2: column 'sway' holds 1e\+300, more than any sensor gives"):
        looked_at(tmp_path, {"t": T, "sway": np.full(N, 1e300)})


def test_roles_by_name_and_by_values(tmp_path):
    columns = {
        "t": T, "u": WAVE, "angle": WAVE, "angle_des": WAVE, "gyro": WAVE, "level2": WAVE, "vel2": rng.normal(size=N),
        "vel3": rng.normal(size=N), "thing": PUSH, "other thing": WAVE, "never": np.ones(N), "slow clock": 7 * T,
    }  # fmt: skip
    assert roles(looked_at(tmp_path, columns)) == {
        "u": "input", "angle": "output", "angle_des": "left out", "gyro": "output", "level2": "output",
        "vel2": "left out", "vel3": "output", "thing": "input", "other thing": "output", "never": "left out",
        "slow clock": "left out",
    }  # fmt: skip


def test_a_column_computed_as_a_difference_is_found_whatever_it_is_called(tmp_path):
    slope = np.concatenate(([0.0], np.diff(WAVE) / np.diff(T)))
    found = looked_at(tmp_path, {"t": T, "a": WAVE, "b": slope, "c": slope + 0.1 * rng.normal(size=N)})
    assert roles(found) == {"a": "output", "b": "left out", "c": "output"}


def test_faults_are_counted_and_answered(tmp_path):
    t, y = T.copy(), [float(v) for v in WAVE]
    t[10], t[20], t[50:] = t[9], t[18], t[50:] + 0.2
    y[30], y[31] = "oops", None
    found = looked_at(tmp_path, {"t": t, "u": PUSH, "y": y})
    time = find_time(found)
    proposals = {p.problem: p.choice for p in propose(found, time, ["u"], ["y"])}
    assert (time.repeated, time.backward, time.gaps, time.filled) == (1, 1, 1, 20)
    assert proposals == {
        "non_number": "mark_missing", "repeated_stamp": "mark_missing", "backward_stamp": "drop",
        "gap": "mark_missing", "unequal_interval": "keep",
    }  # fmt: skip
    assert {p.problem: p.choice for p in propose(found, time, ["u", "y"], ["u"])}["non_number"] == "drop"


def test_a_row_written_twice_is_dropped_and_a_long_gap_splits(tmp_path):
    t, y = T.copy(), WAVE.copy()
    t[10], y[10] = t[9], y[9]
    t[50:] += 5.0
    found = looked_at(tmp_path, {"t": t, "y": y})
    proposals = {p.problem: p.choice for p in propose(found, find_time(found), [], ["y"])}
    assert proposals["repeated_stamp"] == "drop"
    assert proposals["gap"] == "split"


def test_a_clean_log_needs_no_choices(tmp_path):
    found = looked_at(tmp_path, {"t": T, "y": WAVE})
    assert propose(found, find_time(found), [], ["y"]) == ()


def test_decimal_commas_are_found_out(tmp_path):
    file = tmp_path / "log.csv"
    rows = [f"{t:.3f};{y:.6f}".replace(".", ",") for t, y in zip(T, WAVE, strict=True)]
    file.write_text("\n".join(["t;angle", *rows]))
    found = survey(RecordingSource("log", file))
    assert found.source.decimal == ","
    assert find_time(found).interval == pytest.approx(0.01)


def test_a_text_table_without_names_goes_by_numbers(tmp_path):
    file = tmp_path / "log.csv"
    np.savetxt(file, np.column_stack([T, WAVE]), delimiter=" ")
    found = survey(RecordingSource("log", file))
    assert [column.key for column in found.columns] == [1, 2]
    assert find_time(found).key == 1
    assert found.find("2") == 2
    with pytest.raises(DataError, match="no column '3'"):
        found.find("3")


@pytest.mark.parametrize("ending", ["npz", "mat", "h5"])
def test_binary_logs_list_the_columns_of_one_length(tmp_path, ending):
    file = tmp_path / f"log.{ending}"
    y = np.column_stack([WAVE, PUSH])
    if ending == "npz":
        np.savez(file, t=T, y=y, gain=np.ones(3), label=np.array("text"))
        expected = ["t", "y[1]", "y[2]"]
    elif ending == "mat":
        scipy.io.savemat(file, {"log": {"t": T, "y": y, "gain": np.ones(3)}})
        expected = ["log.t", "log.y[1]", "log.y[2]"]
    else:
        with h5py.File(file, "w") as store:
            store["log/t"], store["log/y"], store["log/gain"] = T, y, np.ones(3)
        expected = ["log/t", "log/y[1]", "log/y[2]"]
    source = RecordingSource("log", file)
    assert list_columns(source) == expected
    assert find_time(survey(source)).key == expected[0]


def test_a_file_without_columns_is_refused(tmp_path):
    np.savez(tmp_path / "log.npz", gain=np.ones(1))
    with pytest.raises(DataError, match="no column of numbers"):
        survey(RecordingSource("log", tmp_path / "log.npz"))


def test_columns_are_matched_by_name_by_meaning_or_not_at_all(tmp_path):
    found = looked_at(tmp_path, {"t": T, "pos_meas1": WAVE, "pos_meas2": WAVE, "Q3": WAVE, "tau_cmd": PUSH})
    free = ["pos_meas1", "pos_meas2", "Q3", "tau_cmd"]
    assert match_columns("output", ["q1", "q3", "q2"], found, free, {}) == {
        "q1": "pos_meas1", "q3": "Q3", "q2": "pos_meas2",
    }  # fmt: skip
    assert match_columns("input", ["tau"], found, free, {}) == {"tau": "tau_cmd"}
    assert match_columns("input", ["tau"], found, free, {"tau": "Q3"}) == {"tau": "Q3"}
    with pytest.raises(DataError, match=r"no column looks like .* --output w=COLUMN"):
        match_columns("output", ["w"], found, free, {})
    with pytest.raises(DataError, match="pos_meas1, pos_meas2 could all be"):
        match_columns("output", ["meas"], found, free, {})
    with pytest.raises(DataError, match="no input 'v'"):
        match_columns("input", ["u"], found, free, {"v": "Q3"})


def test_the_swing_up_of_the_pendubot_has_no_speed_sensor():
    file = Path(__file__).parents[2] / "data/measured/pendubot_swing_up.csv"
    found = survey(RecordingSource("log", file))
    why = {role.key: role.why for role in find_roles(found, find_time(found))}
    assert "backward difference of pos_meas2" in why["vel_meas2"]
    # One step of the encoders, in rad.
    assert found.column("pos_meas1").step == pytest.approx(3.8147555e-4, rel=1e-6)
