"""From log files to a dataset: every kind of fault under every policy, with the rows named."""

import re
from pathlib import Path

import numpy as np
import pytest

from noiseid_cli.errors import DataError
from noiseid_cli.recordings import ColumnMap, ProblemPolicy, RecordingSource, TimeMap, import_recordings

INPUTS = (("tau", "N m", "torque"),)
OUTPUTS = (("q", "rad", "angle"), ("w", "rad/s", "speed"))
MEASURED = Path(__file__).parents[2] / "data" / "measured"


def load(file, time=None, inputs=None, outputs=None, rows=None, **policy):
    source = RecordingSource(
        "log",
        file,
        time or TimeMap(column="t"),
        inputs or {"tau": ColumnMap("u")},
        outputs or {"w": ColumnMap("b"), "q": ColumnMap("a")},
        rows=rows,
    )
    return import_recordings("demo", [source], ProblemPolicy(**policy), "some_model", INPUTS, OUTPUTS)


def write(tmp_path, rows):
    file = tmp_path / "log.csv"
    file.write_text("t,u,a,b\n" + "".join(f"{row}\n" for row in rows))
    return file


GOOD = [f"{k},{10 + k},{20 + k},{30 + k}" for k in range(6)]


def test_columns_units_and_order(tmp_path):
    file = write(tmp_path, GOOD)
    data = load(
        file,
        TimeMap(column="t", scale=1e-3, offset=5.0),
        {"tau": ColumnMap(2, scale=2.0, offset=-1.0)},
        {"w": ColumnMap("b", offset=0.5), "q": ColumnMap("a", scale=-1.0)},
    )
    (test,) = data.recordings
    assert (data.name, data.model, data.inputs, data.outputs) == ("demo", "some_model", INPUTS, OUTPUTS)
    assert test.start == 5.0
    np.testing.assert_allclose(test.dt, 1e-3, rtol=1e-12)
    np.testing.assert_array_equal(test.u[:, 0], 2.0 * np.arange(10, 16) - 1.0)
    np.testing.assert_array_equal(test.y, np.column_stack([-np.arange(20.0, 26.0), np.arange(30.5, 36.0)]))
    assert data.notes == ()


def test_a_scale_beyond_all_numbers_is_a_fault_of_its_row(tmp_path):
    file = write(tmp_path, [*GOOD, "6,1e10,26,36", "7,17,-1e10,37"])
    maps = {"tau": ColumnMap("u", scale=1e300)}, {"w": ColumnMap("b"), "q": ColumnMap("a", scale=1e300)}
    with pytest.raises(DataError) as told:
        load(file, None, *maps)
    said = "is {}, which scale and offset carry beyond the largest number"
    assert f"line 8: input 'tau' (column 'u') {said.format('1e+10')}, and it needs one" in str(told.value)
    assert f"line 9: output 'q' (column 'a') {said.format('-1e+10')}" in str(told.value)
    (test,) = load(file, None, *maps, non_number="drop").recordings
    np.testing.assert_array_equal(test.u[:, 0], 1e300 * np.arange(10.0, 16.0))
    with pytest.raises(DataError, match=r"the time .*beyond the largest number"):
        load(file, TimeMap(column="u", scale=1e300))
    (test,) = load(
        write(tmp_path, [*GOOD, "6,16,1e10,36"]), None, {"tau": ColumnMap("u")}, maps[1], non_number="mark_missing"
    ).recordings
    assert np.argwhere(np.isnan(test.y)).tolist() == [[6, 0]]


def test_a_constant_interval_in_place_of_a_time_column(tmp_path):
    (test,) = load(write(tmp_path, GOOD), TimeMap(interval=0.1, offset=2.0)).recordings
    assert test.dt.tolist() == [0.1] * 5
    assert test.start == 2.0
    rows = list(GOOD)
    rows[2] = "2,x,22,32"
    (test,) = load(write(tmp_path, rows), TimeMap(interval=0.1), non_number="drop", unequal_interval="keep").recordings
    assert test.dt.tolist() == [0.1, 0.2, 0.1, 0.1]  # the dropped row leaves its time free


def test_rows_are_chosen(tmp_path):
    (test,) = load(write(tmp_path, GOOD), rows=(2, 4)).recordings
    assert test.y[:, 0].tolist() == [21.0, 22.0, 23.0]


def test_missing_outputs_are_normal_and_counted(tmp_path):
    rows = list(GOOD)
    rows[1], rows[4] = "1,11,,31", "4,14,NaN,"
    data = load(write(tmp_path, rows))
    y = data.recordings[0].y
    assert np.argwhere(np.isnan(y)).tolist() == [[1, 0], [4, 0], [4, 1]]
    assert data.notes == (
        "log: 2 values of output 'q' missing (lines 3, 6)",
        "log: 1 value of output 'w' missing (line 6)",
    )


FAULTY = {
    "non_number": ([*GOOD[:2], "2,12,oops,32", "3,13,inf,33", *GOOD[4:]], "lines 4, 5"),
    "repeated_stamp": ([*GOOD[:3], "2,99,99,99", *GOOD[3:]], "line 5"),
    "backward_stamp": ([*GOOD[:3], "0.5,99,99,99", *GOOD[3:]], "line 5"),
    "gap": ([*GOOD[:3], "7,17,27,37", "8,18,28,38"], "line 5"),
    "unequal_interval": ([*GOOD[:3], "3.5,13,23,33", "4,14,24,34", "5,15,25,35"], "lines 5, 6"),
}


@pytest.mark.parametrize("kind", FAULTY)
def test_each_kind_is_named_with_file_row_and_choices(tmp_path, kind):
    rows, places = FAULTY[kind]
    file = write(tmp_path, rows)
    with pytest.raises(DataError) as caught:
        load(file)
    text = str(caught.value)
    listed = re.findall(re.escape(str(file)) + r", line (\d+): ", text)
    assert listed == re.findall(r"\d+", places)
    assert "import.on_problem" in text
    assert re.findall(r"^  (\w+): ", text, re.MULTILINE) == [kind]


@pytest.mark.parametrize(
    ("kind", "policy", "times", "q", "note"),
    [
        ("non_number", "drop", [0, 1, 4, 5], [20, 21, 24, 25], "2 rows without a usable number dropped"),
        ("non_number", "mark_missing", range(6), [20, 21, None, None, 24, 25], "2 non-numbers in outputs marked"),
        ("repeated_stamp", "drop", range(6), range(20, 26), "1 repeated time stamp dropped"),
        ("repeated_stamp", "mark_missing", range(6), [20, 21, None, 23, 24, 25], "1 repeated time stamp merged"),
        ("backward_stamp", "drop", range(6), range(20, 26), "1 backward time stamp dropped"),
        ("gap", "mark_missing", range(9), [20, 21, 22, *[None] * 4, 27, 28], "1 gap filled with 4 rows"),
        ("unequal_interval", "keep", [0, 1, 2, 3.5, 4, 5], range(20, 26), "2 unequal intervals kept, 0.5 to 1.5 s"),
        ("unequal_interval", "resample", range(6), [20, 21, 22, 22 + 2 / 3, 24, 25], "colours the measurement noise"),
    ],
)
def test_each_policy_is_applied_and_noted(tmp_path, kind, policy, times, q, note):
    rows, places = FAULTY[kind]
    others = {"gap_factor": 3.5, "unequal_interval": "keep"} if (kind, policy) == ("non_number", "drop") else {}
    data = load(write(tmp_path, rows), **({kind: policy} | others))
    (test,) = data.recordings
    np.testing.assert_allclose(test.time, list(times), rtol=1e-15)
    np.testing.assert_allclose(test.y[:, 0], [np.nan if v is None else v for v in q], rtol=1e-15)
    assert note in data.notes[0]
    assert f"({'before ' if kind in ('gap', 'unequal_interval') else ''}{places})" in data.notes[0]


def test_inputs_are_held_over_filled_gaps_and_when_resampled(tmp_path):
    (filled,) = load(write(tmp_path, FAULTY["gap"][0]), gap="mark_missing").recordings
    assert filled.u[:, 0].tolist() == [10, 11, 12, 12, 12, 12, 12, 17, 18]
    (even,) = load(write(tmp_path, FAULTY["unequal_interval"][0]), unequal_interval="resample").recordings
    assert even.u[:, 0].tolist() == [10, 11, 12, 12, 14, 15]
    assert even.dt.tolist() == [1.0] * 5


def test_resampling_keeps_what_is_missing_missing(tmp_path):
    rows = ["0,1,0,0", "1,1,,1", "2,1,2,2", "3.5,1,3.5,3.5", "4,1,4,4"]
    (test,) = load(write(tmp_path, rows), unequal_interval="resample", nominal_interval=0.5).recordings
    expected = np.arange(9) * 0.5
    np.testing.assert_allclose(test.y[:, 1], expected, rtol=1e-15)
    assert np.flatnonzero(np.isnan(test.y[:, 0])).tolist() == [1, 2, 3]


def test_split_at_gaps(tmp_path):
    rows = [*GOOD[:3], "50,1,1,1", "100,17,27,37", "101,18,28,38"]
    data = load(write(tmp_path, rows), gap="split", unequal_interval="keep")
    assert [test.name for test in data.recordings] == ["log", "log-2"]
    assert [test.start for test in data.recordings] == [0.0, 100.0]
    assert data.recordings[1].y.tolist() == [[27.0, 37.0], [28.0, 38.0]]
    assert data.notes == ("log: 2 gaps split the recording (before lines 5, 6); 1 part of a single sample left out",)


def test_a_gap_too_long_to_fill_is_told(tmp_path):
    with pytest.raises(DataError, match=r"filling would need 1e\+06 rows, so only split can be chosen"):
        load(write(tmp_path, [*GOOD, "1000006,1,1,1"]), gap="mark_missing")


def test_gap_factor_tolerance_and_nominal_interval_are_in_force(tmp_path):
    rows = FAULTY["unequal_interval"][0]
    with pytest.raises(DataError, match=r"line 5: 1\.5 s after line 4, 1\.5 times the nominal 1 s"):
        load(write(tmp_path, rows), gap_factor=1.4, unequal_interval="keep")
    assert load(write(tmp_path, rows), interval_tolerance=0.6).notes == ()
    with pytest.raises(DataError, match=r"nominal is 2 s"):
        load(write(tmp_path, GOOD), nominal_interval=2.0)


@pytest.mark.parametrize("bad", ["x,12,22,32", ",12,22,32", "2,,22,32", "2,oops,22,32", "2,12,22"])
def test_inputs_and_time_cannot_be_missing(tmp_path, bad):
    rows = list(GOOD)
    rows[2] = bad
    file = write(tmp_path, rows)
    for policy in ("error", "mark_missing"):
        with pytest.raises(DataError, match=r"line 4: .*(needs one|fields)[\s\S]*non_number: drop"):
            load(file, non_number=policy, unequal_interval="keep")
    data = load(file, non_number="drop", unequal_interval="keep")
    assert data.recordings[0].time.tolist() == [0, 1, 3, 4, 5]
    assert data.notes[0] == "log: 1 row without a usable number dropped (line 4)"


def test_all_faults_are_told_at_once_and_long_lists_are_cut(tmp_path):
    rows = [f"{k},1,{'x' if 30 <= k < 60 else 1},1" for k in range(100)]
    rows[80] = "79,1,1,1"
    rows[90] = "3,1,1,1"
    with pytest.raises(DataError) as caught:
        load(write(tmp_path, rows), unequal_interval="keep")
    text = str(caught.value)
    assert text.startswith("Dataset 'demo': 32 faults in 1 recording.")
    assert text.count("'x', not a finite number") == 6
    assert "and 24 more of this kind" in text
    assert "line 82: time 79 s repeats that of line 81" in text
    assert "line 92: time 3 s is before the 89 s of line 91" in text
    assert len(text.splitlines()) < 20


def test_two_files_make_two_tests_each_with_its_own_columns(tmp_path):
    first = write(tmp_path, GOOD)
    second = tmp_path / "b.csv"
    second.write_text("\n".join(row.replace(",", ";") for row in GOOD))
    named = {"q": ColumnMap("a"), "w": ColumnMap("b")}
    numbered = {"q": ColumnMap(3), "w": ColumnMap(4)}
    sources = [
        RecordingSource("one", first, TimeMap(column="t"), {"tau": ColumnMap("u")}, named),
        RecordingSource("two", second, TimeMap(interval=2.0), {"tau": ColumnMap(2)}, numbered),
    ]
    data = import_recordings("d", sources, ProblemPolicy(), "m", INPUTS, OUTPUTS)
    one, two = data.recordings
    assert (one.name, two.name) == ("one", "two")
    assert one.y.tolist() == two.y.tolist()
    assert (one.dt[0], two.dt[0]) == (1.0, 2.0)
    with pytest.raises(DataError, match="two tests are called 'one'"):
        import_recordings("d", sources[:1] * 2, ProblemPolicy(), "m", INPUTS, OUTPUTS)
    with pytest.raises(DataError, match="names no recordings"):
        import_recordings("d", [], ProblemPolicy(), "m", INPUTS, OUTPUTS)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"inputs": {"tua": ColumnMap("u")}}, "no input 'tua'; it has tau. Did you mean 'tau'?"),
        ({"outputs": {"q": ColumnMap("a")}}, "needs a column for each output; none is given for w"),
        ({"time": TimeMap()}, "either a column or an interval"),
        ({"time": TimeMap(column="t", interval=1.0)}, "either a column or an interval"),
        ({"time": TimeMap(interval=0.0)}, "must be above 0"),
        ({"rows": (0, 3)}, "rows count from 1"),
        ({"rows": (6, 6)}, "has 1 sample; at least 2 are needed"),
    ],
)
def test_contradictory_requests_are_refused(tmp_path, change, words):
    with pytest.raises(DataError, match=re.escape(words)):
        load(write(tmp_path, GOOD), **change)


def measured(file, suffix, **policy):
    source = RecordingSource(
        "log",
        MEASURED / file,
        TimeMap(column="time"),
        {f"tau{k}": ColumnMap(f"tau{suffix}{k}") for k in (1, 2)},
        {f"q{k}": ColumnMap(f"pos{suffix}{k}") for k in (1, 2)},
    )
    inputs = (("tau1", "N m", ""), ("tau2", "N m", ""))
    outputs = (("q1", "rad", ""), ("q2", "rad", ""))
    return import_recordings("pendulum", [source], ProblemPolicy(**policy), "double_pendulum", inputs, outputs)


@pytest.mark.parametrize(
    ("file", "samples", "first", "unequal"),
    [
        ("double_pendulum_excited.csv", 4997, 0.00329995155, 7),
        ("pendubot_swing_up.csv", 7996, 0.00567555428, 6),
    ],
)
def test_the_measured_recordings_come_in_with_their_own_intervals(file, samples, first, unequal):
    data = measured(file, "_meas", unequal_interval="keep")
    (test,) = data.recordings
    assert test.samples == samples
    assert test.dt[0] == first
    raw = np.loadtxt(MEASURED / file, delimiter=",", skiprows=1)
    assert test.y.tobytes() == raw[:, 1:3].copy().tobytes()
    assert test.u.tobytes() == raw[:, 5:7].copy().tobytes()
    assert len(data.notes) == 1
    assert data.notes[0].startswith(f"log: {unequal} unequal intervals kept")


def test_the_recording_at_rest_has_its_repeated_stamp_found():
    with pytest.raises(DataError, match=r"double_pendulum_rest\.csv, line 3: time 0 s repeats that of line 2"):
        measured("double_pendulum_rest.csv", "", unequal_interval="keep")
    data = measured("double_pendulum_rest.csv", "", unequal_interval="keep", repeated_stamp="drop")
    assert data.recordings[0].samples == 1420
    assert data.notes[0] == "log: 1 repeated time stamp dropped (line 3)"
