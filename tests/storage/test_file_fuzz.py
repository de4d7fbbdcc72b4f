"""Damaged files of ours, and HDF5 files of others: each ends in one sentence; no traceback, no signal, no hang.

In the suite a few of them, in `make fuzz` many.
"""

import random
import time

import h5py
import numpy as np
import pytest
from fuzz import SEED, examples
from typer.testing import CliRunner

from noiseid_cli.app import app
from noiseid_cli.errors import DataError
from noiseid_cli.models.recording import Dataset, Recording
from noiseid_cli.recordings import RecordingSource
from noiseid_cli.recordings.readers import read_table
from noiseid_cli.storage.dataset_file import read_dataset, write_dataset
from noiseid_cli.storage.hdf5 import _SEAL_SIZE, _seal

SLOWEST = 20.0


def damaged(data: bytes, rng: random.Random) -> bytes:
    """The bytes cut, flipped, overwritten or exchanged."""
    out = bytearray(data)
    kind = rng.randrange(4)
    if kind == 0:
        return bytes(out[: rng.randrange(len(out))])
    if kind == 1:
        for _ in range(rng.randint(1, 20)):
            out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)
    elif kind == 2:
        i = rng.randrange(len(out))
        out[i : i + rng.randint(1, 64)] = rng.randbytes(rng.randint(1, 64))
    else:
        i, j = sorted(rng.randrange(len(out)) for _ in range(2))
        del out[i : min(j, i + 200)]
    return bytes(out)


@pytest.fixture
def whole(tmp_path):
    """A dataset file of ours."""
    rng = np.random.default_rng(0)
    test = Recording("a", np.ones(699), np.zeros((700, 1)), rng.normal(size=(700, 2)))
    columns = {"inputs": (("u", "", ""),), "outputs": (("p", "", ""), ("q", "", ""))}
    path = tmp_path / "whole.h5"
    write_dataset(path, Dataset("d", "m", (test,), **columns), {})
    return path


def test_damaged_files_of_ours_end_in_a_sentence(whole, tmp_path, tried):
    rng, data, path = random.Random(1 + 1000 * SEED), whole.read_bytes(), tmp_path / "bad.h5"
    for _ in range(examples(60)):
        tried()
        bad = damaged(data, rng)
        if bad == data:
            continue
        path.write_bytes(bad)
        with pytest.raises(DataError, match=r"bad\.h5"):
            read_dataset(path)
    result = CliRunner().invoke(app, ["inspect", str(path)])
    assert result.exit_code == 3
    assert result.stderr.startswith("noiseid: ")
    assert "Traceback" not in result.stderr


def test_a_forged_seal_does_not_help(whole, tmp_path):
    """An empty or foreign HDF5 image with a right checksum is of no format of ours."""
    path = tmp_path / "forged.h5"
    with h5py.File(path, "w") as file:
        file["time"] = np.zeros((1, 3))
    image = path.read_bytes()
    path.write_bytes(image + _seal(image))
    with pytest.raises(DataError, match=r"forged\.h5"):
        read_dataset(path)
    assert whole.read_bytes()[-_SEAL_SIZE:] == _seal(whole.read_bytes()[:-_SEAL_SIZE])


def test_damaged_files_of_others_end_in_a_sentence_or_in_numbers(tmp_path, tried):
    good, path, rng = tmp_path / "good.h5", tmp_path / "bad.h5", random.Random(2 + 1000 * SEED)
    with h5py.File(good, "w") as file:
        file["t"] = np.arange(100.0)
        file.create_dataset("log/y", data=np.random.default_rng(0).normal(size=(100, 2)), compression="gzip")
    data = good.read_bytes()
    for _ in range(examples(3, 20)):
        tried()
        path.write_bytes(damaged(data, rng))
        began = time.monotonic()
        said = "bad.h5"
        try:
            table = read_table(RecordingSource("log", path), ["t", "log/y[1]"])
            assert len(table.columns["t"]) == len(table.columns["log/y[1]"])
        except DataError as error:
            said = str(error)
        assert "bad.h5" in said
        assert "Traceback" not in said
        assert time.monotonic() - began < SLOWEST
