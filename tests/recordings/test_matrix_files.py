"""Matrices from CSV, npz, MAT and HDF5 files."""

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from noiseid_cli.errors import DataError
from noiseid_cli.recordings.matrices import read_matrices, read_matrix

A = np.array([[1.0, 0.25, -3e-7], [0.0, 1.0, 2.0]])
VARYING = np.arange(24.0).reshape(4, 2, 3)
NARROW = np.arange(4.0).reshape(4, 1, 1)


@pytest.mark.parametrize("text", ["1, 0.25, -3e-7\n0, 1, 2\n", "1 0.25 -3e-7\n0 1 2", "# A\n1;0.25;-3e-7\n\n0;1;2\n"])
def test_a_matrix_from_csv(tmp_path, text):
    (tmp_path / "a.csv").write_text(text)
    np.testing.assert_array_equal(read_matrix(tmp_path / "a.csv"), A)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,2\n3,x\n", "line 2: x where a finite number is needed"),
        ("1,2\n3,\n", "line 2: an entry is missing"),
        ("1,2\n3\n", "line 2"),
    ],
)
def test_faults_of_a_csv_matrix_are_told_with_their_line(tmp_path, text, message):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(DataError, match=message):
        read_matrix(tmp_path / "a.csv")


def save(file, **arrays):
    if file.suffix == ".npz":
        np.savez(file, **arrays)
    elif file.suffix == ".mat":
        savemat(file, {k: np.moveaxis(v, 0, -1) if v.ndim == 3 else v for k, v in arrays.items()})
    else:
        with h5py.File(file, "w") as store:
            for name, array in arrays.items():
                store[name] = array


@pytest.mark.parametrize("ending", ["npz", "mat", "h5"])
def test_constant_and_varying_matrices_in_their_shapes(tmp_path, ending):
    file = tmp_path / f"m.{ending}"
    save(file, A=A, C=VARYING, D=NARROW, Z=np.eye(9))
    found = read_matrices(file, ["A"], ["B", "C", "D"])
    assert list(found) == ["A", "C", "D"]
    for name, expected in (("A", A), ("C", VARYING), ("D", NARROW)):
        np.testing.assert_array_equal(found[name], expected)


def test_what_is_not_there_or_no_matrix_is_told(tmp_path):
    save(tmp_path / "m.npz", A=A, c=np.arange(3.0))
    with pytest.raises(DataError, match=r"has no column 'C'.*'A', 'c'"):
        read_matrices(tmp_path / "m.npz", ["C"])
    with pytest.raises(DataError, match=r"'c' has the shape \(3,\); a matrix has rows and columns"):
        read_matrices(tmp_path / "m.npz", ["c"])
    with pytest.raises(DataError, match=r"name it at its letter, as in A: a\.csv"):
        read_matrices(tmp_path / "a.csv", ["A"])
    with pytest.raises(DataError, match="npz, MAT and HDF5 files go under `file`"):
        read_matrix(tmp_path / "m.npz")
    with pytest.raises(DataError, match="does not tell what kind of file it is; take npz, mat or h5"):
        read_matrices(tmp_path / "m.bin", ["A"])
