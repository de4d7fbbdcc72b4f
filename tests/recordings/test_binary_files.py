"""MAT, HDF5 and npz files: the same data as CSV; damaged and hostile ones are refused."""

import struct

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from noiseid_cli.errors import DataError
from noiseid_cli.recordings import ColumnMap, ProblemPolicy, RecordingSource, TimeMap, binary, import_recordings
from noiseid_cli.recordings.readers import read_table

N = 50
RNG = np.random.default_rng(5)
T, U, Y = np.arange(N) * 0.125, RNG.normal(size=N), RNG.normal(size=(N, 2))
Y[7, 1] = np.nan


def mat73(path, values):
    """MATLAB's v7.3: HDF5 behind 512 bytes, structs as groups, matrices transposed."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in values.items():
            file[name.replace(".", "/")] = np.atleast_2d(value).T if np.ndim(value) == 2 else value[:, None].T
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file".ljust(124) + struct.pack("<H", 0x0200) + b"IM")


def write_all(folder):
    table = np.column_stack([T, U, Y])
    np.savetxt(folder / "a.csv", table, delimiter=",", fmt="%.17g", header="t,u,a,b", comments="")
    savemat(folder / "b.mat", {"t": T, "log": {"u": U[:, None], "y": Y}, "text": "words"})
    mat73(folder / "c.mat", {"t": T, "log.u": U, "log.y": Y})
    with h5py.File(folder / "d.h5", "w") as file:
        file["t"], file["log/u"], file["log/y"] = T, U.reshape(-1, 1), Y
        file["alias"] = h5py.SoftLink("/log")
    np.savez(folder / "e.npz", t=T, u=U, y=Y)


@pytest.mark.parametrize(
    ("file", "u", "a", "b"),
    [
        ("b.mat", "log.u", "log.y[1]", "log/y[2]"),
        ("c.mat", "log.u", "log/y[1]", "log.y[2]"),
        ("d.h5", "/log/u", "log/y[1]", "alias/y[2]"),
        ("e.npz", "u", "y[1]", "y[2]"),
    ],
)
def test_all_formats_give_the_same_dataset(tmp_path, file, u, a, b):
    write_all(tmp_path)

    def load(name, u, a, b):
        source = RecordingSource(
            "log",
            tmp_path / name,
            TimeMap(column="t"),
            {"tau": ColumnMap(u)},
            {"q": ColumnMap(a), "w": ColumnMap(b)},
            rows=(3, 40),
        )
        outputs = (("q", "", ""), ("w", "", ""))
        return import_recordings("demo", [source], ProblemPolicy(), "m", (("tau", "", ""),), outputs)

    one, other = load("a.csv", "u", "a", "b"), load(file, u, a, b)
    (p,), (q,) = one.recordings, other.recordings
    for name in ("dt", "u", "y"):
        assert getattr(p, name).tobytes() == getattr(q, name).tobytes()
    assert p.start == q.start == 0.25
    assert one.notes == ("log: 1 value of output 'w' missing (line 9)",)
    assert other.notes == ("log: 1 value of output 'w' missing (row 8)",)


@pytest.mark.parametrize(
    ("file", "wanted", "words"),
    [
        ("b.mat", ["log.v"], r"no column 'log.v'; it has 't', 'log.u', 'log.y'\. Did you mean 'log\.[uy]'"),
        ("c.mat", ["log.v"], r"it has 'log.u', 'log.y', 't'"),
        ("e.npz", ["y"], r"'y' has the shape \[?\(?50, 2\)?\]?; name one of its columns, as in 'y\[1\]'"),
        ("e.npz", ["y[3]"], "there is no column 3"),
        ("d.h5", ["log"], "no column 'log'; it has"),
        ("d.h5", [2], "columns go by number in CSV files only"),
    ],
)
def test_wrong_columns_are_told(tmp_path, file, wanted, words):
    write_all(tmp_path)
    with pytest.raises(DataError, match=words):
        read_table(RecordingSource("log", tmp_path / file), wanted)


def test_unequal_lengths_infinities_and_text_are_told(tmp_path):
    file = tmp_path / "f.npz"
    np.savez(file, a=np.array([1.0, np.inf, 3.0]), b=np.ones(4), words=np.array(["x"]), n=np.arange(3, dtype="i2"))
    table = read_table(RecordingSource("log", file), ["a", "n"])
    assert [(cell.row, cell.column, cell.text) for cell in table.bad] == [(1, "a", "inf")]
    assert np.isnan(table.columns["a"][1])
    assert table.columns["n"].tolist() == [0.0, 1.0, 2.0]
    with pytest.raises(DataError, match="differ in length: 'a' 3, 'b' 4"):
        read_table(RecordingSource("log", file), ["a", "b"])
    with pytest.raises(DataError, match="plain real numbers"):
        read_table(RecordingSource("log", file), ["words"])
    with pytest.raises(DataError, match="no data rows in the chosen range"):
        read_table(RecordingSource("log", file, rows=(5, None)), ["a"])


class Canary:
    """Unpickling this would write a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (str(self.path), "w")


def test_nothing_pickled_is_loaded(tmp_path):
    np.savez(tmp_path / "p.npz", a=np.array([Canary(tmp_path / "canary")], dtype=object))
    with pytest.raises(DataError, match="cannot be read as a npz file"):
        read_table(RecordingSource("log", tmp_path / "p.npz"), ["a"])
    assert not (tmp_path / "canary").exists()


def external_link(file, canary):
    file["y"] = h5py.ExternalLink(str(canary), "/secret")


def soft_link_to_external_link(file, canary):
    file["door"] = h5py.ExternalLink(str(canary), "/")
    file["y"] = h5py.SoftLink("/door/secret")


def external_storage(file, canary):
    file.create_dataset("y", (2,), dtype="f8", external=[(str(canary), 0, 16)])


def virtual_dataset(file, canary):
    layout = h5py.VirtualLayout((2,), "f8")
    layout[:] = h5py.VirtualSource(str(canary), "secret", (2,))
    file.create_virtual_dataset("y", layout)


def object_reference(file, canary):
    file["real"] = np.zeros(2)
    file.create_dataset("y", data=np.array([file["real"].ref] * 2, dtype=h5py.ref_dtype))


def shape_bomb(file, canary):
    file.create_dataset("y", (10**12,), dtype="f8", chunks=(1000,), compression="gzip")


def link_loop(file, canary):
    file["y"] = h5py.SoftLink("/z")
    file["z"] = h5py.SoftLink("/y")


@pytest.mark.parametrize(
    ("trick", "words"),
    [
        (external_link, "link into another file"),
        (soft_link_to_external_link, "link into another file"),
        (external_storage, "keeps its data in another file"),
        (virtual_dataset, "virtual dataset"),
        (object_reference, "plain real numbers are needed"),
        (shape_bomb, "more than 1 GiB"),
        (link_loop, "leads through too many"),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_a_file_that_leads_elsewhere_is_refused(tmp_path, trick, words):
    canary, bad = tmp_path / "canary.h5", tmp_path / "bad.h5"
    with h5py.File(canary, "w") as file:
        file["secret"] = np.array([271828.5, 314159.25])
    before = canary.read_bytes()
    with h5py.File(bad, "w") as file:
        trick(file, canary)
    with pytest.raises(DataError, match=words) as caught:
        read_table(RecordingSource("log", bad), ["y"])
    assert "271828" not in str(caught.value)
    assert canary.read_bytes() == before


def test_damaged_files_end_in_an_error_or_in_numbers_never_in_a_crash(tmp_path):
    write_all(tmp_path)
    rng = np.random.default_rng(11)
    outcomes = []
    for name, wanted in (("b.mat", "log.u"), ("d.h5", "log/u"), ("e.npz", "u")):
        good = (tmp_path / name).read_bytes()
        variants = [good[: len(good) // 3], b"junk" * 100]
        variants.append(bytes(b ^ int(rng.integers(256)) if k % 37 == 0 else b for k, b in enumerate(good)))
        for data in variants:
            file = tmp_path / f"bad{name}"
            file.write_bytes(data)
            with pytest.raises(DataError, match=f"bad{name}") as caught:
                read_table(RecordingSource("log", file), [wanted])
            outcomes.append(str(caught.value))
    assert all("Traceback" not in text for text in outcomes)


@pytest.mark.parametrize(
    ("script", "words"),
    [
        ("import time; time.sleep(60)", "could not be read within 0.5 s"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", r"broke down on it \(SIGSEGV\)"),
        ("raise SystemExit(7)", r"broke down on it \(exit code 7\)"),
    ],
)
def test_a_reader_that_hangs_or_crashes_becomes_a_sentence(tmp_path, monkeypatch, script, words):
    write_all(tmp_path)
    child = tmp_path / "child.py"
    child.write_text(script)
    monkeypatch.setattr(binary, "_CHILD", child)
    monkeypatch.setattr(binary, "TIME_LIMIT", 0.5)
    with pytest.raises(DataError, match=words):
        read_table(RecordingSource("log", tmp_path / "d.h5"), ["t"])
