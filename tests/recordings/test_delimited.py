"""Text tables: delimiters, headers, decimal marks, missing cells, and the line of every fault."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from noiseid_cli.errors import DataError
from noiseid_cli.recordings.options import RecordingSource
from noiseid_cli.recordings.readers import read_table, source_digest


def read(tmp_path, text, wanted, encoding="utf-8", **options):
    file = tmp_path / "log.csv"
    file.write_bytes(text.encode(encoding))
    return read_table(RecordingSource("log", file, **options), wanted)


@pytest.mark.parametrize(
    "text",
    [
        "time,a,b\n0,1,2\n0.5,3,-4e-3\n",
        "time;a;b\n0;1;2\n0.5;3;-4e-3\n",
        "time\ta\tb\n0\t1\t2\n0.5\t3\t-4e-3\n",
        "time|a|b\n0|1|2\n0.5|3|-4e-3\n",
        "  time  a   b\n  0   1 2\n0.5 3    -4e-3\n",
        "time, a, b\r\n0, 1, 2\r\n0.5, 3, -4e-3\r\n",
        '"time","a","b"\n"0","1","2"\n"0.5","3","-4e-3"\n',
        "\ufefftime,a,b\n0,1,2\n0.5,3,-4e-3\n",
        "# a logger wrote this, on a Monday\n\ntime,a,b\n0,1,2\n\n# halfway\n0.5,3,-4e-3",
        "time,a,b\n0,1,2,\n0.5,3,-4e-3,\n",
    ],
)
def test_the_same_table_in_many_guises(tmp_path, text):
    table = read(tmp_path, text, ["time", "b", "a"])
    assert table.names == ("time", "a", "b")
    assert {key: list(values) for key, values in table.columns.items()} == {
        "time": [0.0, 0.5],
        "a": [1.0, 3.0],
        "b": [2.0, -4e-3],
    }
    assert table.bad == ()
    lines = text.splitlines()
    assert [lines[number - 1].strip('" ')[0] for number in table.row_numbers] == ["0", "0"]


def test_decimal_comma(tmp_path):
    table = read(tmp_path, "time;a\n0,25;1\n0,5;-2,5e-3\n1,0;1.5\n", ["time", "a"], decimal=",")
    assert list(table.columns["time"]) == [0.25, 0.5, 1.0]
    assert table.columns["a"][1] == -2.5e-3
    assert [(cell.row, cell.text) for cell in table.bad] == [(2, "1.5")]  # a point in such a file is no number


def test_options_overrule_what_would_be_found_out(tmp_path):
    text = "! made, by, hand\n1 2,3\n5 6,7\n"
    assert read(tmp_path, text, [1], comment="!", delimiter=" ").columns[1].tolist() == [1.0, 5.0]
    assert read(tmp_path, text, [2], comment="!", delimiter=",").columns[2].tolist() == [3.0, 7.0]
    table = read(tmp_path, "%x\n1 ; 2\n3 ; 4\n", ["1"], comment="%", header=True, delimiter=";")
    assert table.columns["1"].tolist() == [3.0]
    table = read(tmp_path, "a,b\n3,4\n", [1], header=False)
    assert [(cell.row, cell.text) for cell in table.bad] == [(0, "a")]
    assert table.columns[1][1] == 3.0


def test_without_a_header_columns_go_by_number(tmp_path):
    table = read(tmp_path, "0,1,2\n1,3,4\n", [1, 3])
    assert table.columns[3].tolist() == [2.0, 4.0]
    assert table.names == ("column 1", "column 2", "column 3")
    with pytest.raises(DataError, match=r"no header with names, so there is no column 'y'.*header: true"):
        read(tmp_path, "0,1,2\n1,3,4\n", ["y"])
    with pytest.raises(DataError, match="no column number 4; it has 3 columns"):
        read(tmp_path, "0,1,2\n1,3,4\n", [4])


def test_a_first_row_with_a_bad_cell_is_not_taken_for_a_header(tmp_path):
    table = read(tmp_path, "x,1,\n1,3,4\n", [1, 2])
    assert [(cell.row, cell.text) for cell in table.bad] == [(0, "x")]
    assert table.columns[2].tolist() == [1.0, 3.0]
    assert read(tmp_path, "t,1,2\n0,3,4\n", ["2"], header=True).columns["2"].tolist() == [4.0]


def test_one_column_and_one_row(tmp_path):
    assert read(tmp_path, "y\n1\n2\n", ["y"]).columns["y"].tolist() == [1.0, 2.0]
    assert read(tmp_path, "4,5\n", [2]).columns[2].tolist() == [5.0]


def test_rows_are_data_rows_and_line_numbers_stay_those_of_the_file(tmp_path):
    text = "# c\ny,z\n1,0\n\n2,0\n3,0\n4,0\n"
    table = read(tmp_path, text, ["y"], rows=(2, 3))
    assert table.columns["y"].tolist() == [2.0, 3.0]
    assert table.row_numbers.tolist() == [5, 6]
    assert read(tmp_path, text, ["y"], rows=(3, None)).columns["y"].tolist() == [3.0, 4.0]
    with pytest.raises(DataError, match="no data rows in the chosen range"):
        read(tmp_path, text, ["y"], rows=(9, None))


def test_missing_cells_are_no_faults_and_others_are_named(tmp_path):
    text = "t,y,note\n0,,a\n1,NaN,b\n2,NA,c\n3,n/a,d\n4,null,e\n5,abc,f\n6,inf,g\n7,1_000,h\n8\n9,1,2,3\n10,5,i\n"
    table = read(tmp_path, text, ["t", "y"])
    assert np.isnan(table.columns["y"][:10]).all()
    assert table.columns["y"][10] == 5.0
    found = [(int(table.row_numbers[cell.row]), cell.column, cell.text) for cell in table.bad]
    assert found == [
        (7, "y", "abc"),
        (8, "y", "inf"),
        (9, "y", "1_000"),
        (10, "", "1 fields where 3 are expected"),
        (11, "", "4 fields where 3 are expected"),
    ]


def test_a_fault_deep_in_a_long_file_has_its_line(tmp_path):
    lines = ["t,y"] + [f"{k},{k}" for k in range(45_000)]
    lines[44_321] = "x,1"
    table = read(tmp_path, "\n".join(lines), ["t", "y"])
    assert [(int(table.row_numbers[cell.row]), cell.text) for cell in table.bad] == [(44_322, "x")]
    expected = np.arange(45_000.0)
    expected[44_320] = 1.0
    np.testing.assert_array_equal(table.columns["y"], expected)


@pytest.mark.parametrize("encoding", ["utf-16", "latin-1", "utf-8"])
def test_encodings(tmp_path, encoding):
    table = read(tmp_path, "Zeit,Wärme °C\n0,1\n1,2\n", ["Wärme °C"], encoding=encoding)
    assert table.columns["Wärme °C"].tolist() == [1.0, 2.0]


def test_a_quotation_mark_before_more_than_a_field_may_hold_is_a_bad_cell(tmp_path):
    table = read(tmp_path, 't,y\n0,1\n1,"' + "x" * 200_000 + "\n2,3\n", ["t", "y"])
    assert table.columns["t"].tolist() == [0, 1, 2]
    assert [(cell.row, cell.column) for cell in table.bad] == [(1, "y")]


def test_unknown_and_ambiguous_columns(tmp_path):
    with pytest.raises(DataError, match=r"no column 'pos_meas1'; it has 'time', 'pos1', 'pos2'\. Did you mean 'pos1'"):
        read(tmp_path, "time,pos1,pos2\n0,1,2\n", ["pos_meas1"])
    with pytest.raises(DataError, match="more than one column 'y'; name it by its number: 2 and 3"):
        read(tmp_path, "time,y,y\n0,1,2\n", ["y"])


@pytest.mark.parametrize(
    ("content", "words"),
    [(b"", "is empty"), (b"# only\n\n", "no rows"), (b"a,b\n", "no data rows"), (b"a\0b\n", "not a text file")],
)
def test_files_without_a_table(tmp_path, content, words):
    file = tmp_path / "log.csv"
    file.write_bytes(content)
    with pytest.raises(DataError, match=words):
        read_table(RecordingSource("log", file), ["a"])


def test_missing_files_folders_and_unknown_kinds(tmp_path):
    with pytest.raises(DataError, match="cannot be found"):
        read_table(RecordingSource("log", tmp_path / "no.csv"), ["a"])
    with pytest.raises(DataError, match="not a plain file"):
        read_table(RecordingSource("log", tmp_path, kind="csv"), ["a"])
    with pytest.raises(DataError, match="set its kind"):
        read_table(RecordingSource("log", Path("log.xyz")), ["a"])


@settings(max_examples=50)
@given(
    values=st.lists(st.tuples(*[st.floats(allow_nan=False, allow_infinity=False)] * 3), min_size=2, max_size=6),
    delimiter=st.sampled_from([",", ";", "\t", "|", " "]),
)
def test_every_number_is_the_number_written(tmp_path_factory, values, delimiter):
    folder = tmp_path_factory.mktemp("numbers")
    table = read(folder, "\n".join(delimiter.join(map(repr, row)) for row in values), [1, 2, 3], header=False)
    got = np.column_stack([table.columns[k] for k in (1, 2, 3)])
    assert got.tobytes() == np.array(values).tobytes()


def test_digest_is_the_sha256_of_the_file(tmp_path):
    (tmp_path / "log.csv").write_bytes(b"abc")
    assert source_digest(tmp_path / "log.csv").startswith("ba7816bf8f01cfea")
