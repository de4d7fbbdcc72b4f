"""Dataset files: exact round trips, damage, hostile content, how xarray shows them."""

import hashlib
import io
import os
import subprocess
import sys
from dataclasses import fields, replace

import h5py
import numpy as np
import pytest
import xarray
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from noiseid_cli.errors import DataError
from noiseid_cli.models.recording import Dataset, Recording
from noiseid_cli.storage import dataset_file, hdf5
from noiseid_cli.storage.dataset_file import read_attributes, read_dataset, write_dataset

any_float = st.floats(allow_nan=True, allow_infinity=True, allow_subnormal=True)
texts = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=8)


def same_bits(a, b):
    """Equality to the bit: signs of zero and NaN payloads count."""
    if a is None or b is None:
        return a is b
    return a.shape == b.shape and a.dtype == b.dtype == np.float64 and a.tobytes() == b.tobytes()


def assert_same(one, other):
    for field in fields(Dataset):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if field.name.endswith("_true"):
            assert same_bits(a, b)
        elif field.name != "recordings":
            assert a == b
    for a, b in zip(one.recordings, other.recordings, strict=True):
        assert a.name == b.name
        assert np.float64(a.start).tobytes() == np.float64(b.start).tobytes()
        for name in ("dt", "u", "y", "x_true", "z_true", "parameters_true"):
            assert same_bits(getattr(a, name), getattr(b, name)), name


GROUPS = ("inputs", "outputs", "states", "performances", "parameters")


@st.composite
def datasets(draw):
    sizes = {name: draw(st.integers(0, 3)) for name in GROUPS}
    columns = {
        name: tuple((f"{name}{k}", draw(texts), draw(texts)) for k in range(size)) for name, size in sizes.items()
    }
    tests = []
    for k in range(draw(st.integers(1, 3))):
        n = draw(st.integers(1, 5))
        part = lambda *shape: draw(arrays(np.float64, shape, elements=any_float))  # noqa: E731
        x_true = part(n, sizes["states"]) if draw(st.booleans()) else None
        z_true = part(n, sizes["performances"]) if draw(st.booleans()) else None
        p_true = part(n, sizes["parameters"]) if draw(st.booleans()) else None
        u, y = part(n, sizes["inputs"]), part(n, sizes["outputs"])
        start = draw(st.floats(-1e3, 1e3))
        tests.append(Recording(f"{k}{draw(texts)}", part(n - 1), u, y, start, x_true, z_true, p_true))
    Q = draw(st.none() | arrays(np.float64, (2, 2), elements=any_float))
    R = draw(st.none() | arrays(np.float64, (sizes["outputs"],) * 2, elements=any_float))
    if sizes["outputs"] == 0:
        R = None
    notes = tuple(draw(st.lists(texts, max_size=2)))
    return Dataset(draw(texts), draw(texts), tuple(tests), **columns, Q_true=Q, R_true=R, notes=notes)


def example(n=700):
    rng = np.random.default_rng(1)
    y = rng.normal(size=(n, 2))
    y[3, 1] = np.nan
    long = Recording(
        "long", np.full(n - 1, 0.002), rng.normal(size=(n, 1)), y, 0.5, rng.normal(size=(n, 3)), np.ones((n, 1))
    )
    short = replace(long, name="short", dt=long.dt[:9], u=long.u[:10], y=y[:10], x_true=None, z_true=None)
    return Dataset(
        "demo",
        "flexible_robot",
        (long, short),
        inputs=(("tau", "N m", "motor torque"),),
        outputs=(("q", "rad", "motor angle"), ("acc", "m/s^2", "tool acceleration")),
        states=(("q", "rad", "angle"), ("dq", "rad/s", "speed"), ("b", "N m", "bias")),
        performances=(("p", "m", "tool position"),),
        Q_true=np.eye(2),
        R_true=np.diag([1e-12, 1e-3]),
        notes=("2 repeated time stamps dropped (lines 14, 99)",),
    )


@settings(max_examples=60)
@given(dataset=datasets())
def test_round_trip_is_exact_to_the_bit(tmp_path, dataset):
    write_dataset(tmp_path / "d.h5", dataset, {})
    assert_same(read_dataset(tmp_path / "d.h5"), dataset)


def test_compressed_arrays_and_attributes_come_back(tmp_path):
    path = tmp_path / "d.h5"
    attributes = {"config": '{"experiment": "ü"}', "long": "x" * 200_000, "empty": ""}
    write_dataset(path, example(), attributes)
    assert_same(read_dataset(path), example())
    assert read_attributes(path).items() >= attributes.items()
    assert read_attributes(path)["format"] == hdf5.read_format(path) == "noiseid-dataset"


def test_a_file_from_before_parameters_could_change_still_opens(tmp_path, monkeypatch):
    path, write = tmp_path / "d.h5", dataset_file._fill_true_path
    with monkeypatch.context() as old:
        old.setattr(
            dataset_file, "_fill_true_path", lambda t, name, *rest: None if name == "p" else write(t, name, *rest)
        )
        write_dataset(path, example(), {})
    assert_same(read_dataset(path), example())


def test_true_parameters_stand_in_the_file_with_their_names(tmp_path):
    path = tmp_path / "d.h5"
    columns = (("mu", "N m", "friction"), ("m", "kg", "mass"))
    data = example()
    tests = (replace(data.recordings[0], parameters_true=np.arange(1400.0).reshape(700, 2)), data.recordings[1])
    write_dataset(path, replace(data, recordings=tests, parameters=columns), {})
    with xarray.open_dataset(path, group="truth") as truth:
        assert truth["p"].dims == ("test", "sample", "parameter")
        assert list(truth["parameter"].values) == ["mu", "m"]
        assert truth["p"].long_name == "true parameter"
        assert truth["p"].values[0, 699].tolist() == [1398, 1399]
    with pytest.raises(DataError, match=r"parameters_true of test 'long' has shape \(700, 2\)"):
        write_dataset(path, replace(data, recordings=tests), {})


def test_same_content_gives_same_bytes_in_another_process_too(tmp_path):
    first, second = tmp_path / "1.h5", tmp_path / "2.h5"
    write_dataset(first, example(), {"a": "b"})
    code = (
        "import sys; from pathlib import Path; from noiseid_cli.storage.dataset_file import *;"
        "d = Path(sys.argv[1]); write_dataset(Path(sys.argv[2]), read_dataset(d), {'a': 'b'})"
    )
    subprocess.run([sys.executable, "-c", code, str(first), str(second)], check=True)
    assert first.read_bytes() == second.read_bytes()


def test_xarray_opens_the_file_as_it_is(tmp_path):
    path = tmp_path / "d.h5"
    write_dataset(path, example(), {"config": "{}"})
    with xarray.open_dataset(path) as data:
        shown = repr(data)
        assert data["y"].dims == ("test", "sample", "output")
        assert list(data["output"].values) == ["q", "acc"]
        assert list(data["output_unit"].values) == ["rad", "m/s^2"]
        assert set(data.coords) >= {"time", "test", "sample", "input_unit", "output_description"}
        assert data["u"].units == "N m"
        assert data["time"].units == "s"
        np.testing.assert_array_equal(data["y"].sel(test="long").values, example().recordings[0].y)
        assert np.isnan(data["y"].sel(test="short").values[10:]).all()
        assert data["length"].values.tolist() == [700, 10]
    assert "q [rad], acc [m/s^2]" in shown
    with xarray.open_dataset(path, group="truth") as truth:
        assert truth["x"].dims == ("test", "sample", "state")
        assert truth["Q"].dims == ("noise", "noise_")
        assert truth["R"].attrs["units"]


def test_every_variable_has_a_unit_or_is_text_and_no_number_is_short(tmp_path):
    write_dataset(tmp_path / "d.h5", example(), {})
    seen = []

    def check(name, item):
        if isinstance(item, h5py.Dataset):
            seen.append(name)
            assert item.dtype in (np.float64, np.int64, object)
            assert item.attrs["long_name"]
            assert item.dtype == object or item.is_scale or item.attrs["units"]
            if item.size > 512 and not item.is_scale:
                assert (item.compression, item.shuffle, item.fletcher32) == ("gzip", True, True)

    with h5py.File(tmp_path / "d.h5") as file:
        file.visititems(check)
    assert {"y", "u", "time", "interval", "length", "truth/x", "truth/z", "truth/Q", "truth/R"} <= set(seen)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"recordings": ()}, "no recordings"),
        ({"inputs": ()}, "u of test 'long' has shape \\(700, 1\\)"),
        ({"recordings": example().recordings[:1] * 2}, "same name"),
        ({"Q_true": np.ones((2, 3))}, "'Q' has 3 entries along 'noise_'"),
        ({"name": "a\0b"}, "NUL"),
        ({"outputs": (("a\0", "", ""), ("b", "", ""))}, "NUL"),
    ],
)
def test_a_dataset_that_could_not_come_back_is_refused(tmp_path, change, words):
    with pytest.raises(DataError, match=words):
        write_dataset(tmp_path / "d.h5", replace(example(), **change), {})
    assert list(tmp_path.iterdir()) == []


def test_a_reserved_attribute_is_refused(tmp_path):
    with pytest.raises(DataError, match="'format' belongs to the file format"):
        write_dataset(tmp_path / "d.h5", example(), {"format": "x"})


def test_no_flipped_bit_and_no_lost_byte_goes_unseen(tmp_path):
    path = tmp_path / "d.h5"
    write_dataset(path, example(20), {})
    good = path.read_bytes()
    rng = np.random.default_rng(3)
    places = [*rng.integers(0, len(good), 200), *range(len(good) - hdf5._SEAL_SIZE, len(good))]
    for place in places:
        bad = bytearray(good)
        bad[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(bad)
        with pytest.raises(DataError, match=r"d\.h5"):
            read_dataset(path)
    for size in [*rng.integers(0, len(good), 40), len(good) - 1]:
        path.write_bytes(good[:size])
        with pytest.raises(DataError, match=r"d\.h5"):
            read_dataset(path)


def test_each_wrong_file_gets_its_own_sentence(tmp_path):
    def message(path):
        with pytest.raises(DataError) as caught:
            read_dataset(path)
        assert str(path) in str(caught.value)
        assert "noiseid-dataset" in str(caught.value)
        return str(caught.value)

    assert "does not exist" in message(tmp_path / "none.h5")
    assert "is a folder" in message(tmp_path)
    os.mkfifo(tmp_path / "pipe.h5")
    assert "pipe" in message(tmp_path / "pipe.h5")
    (tmp_path / "empty.h5").write_bytes(b"")
    assert "is empty" in message(tmp_path / "empty.h5")
    (tmp_path / "log.csv").write_text("time,y\n0,1\n")
    assert "not an HDF5 file" in message(tmp_path / "log.csv")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["a"] = np.zeros(3)
    assert "another program" in message(tmp_path / "other.h5")
    with pytest.raises(DataError, match="another program wrote it; expected a noiseid file"):
        hdf5.read_format(tmp_path / "other.h5")
    (tmp_path / "result.h5").write_bytes(hdf5.build("noiseid-result", 1, lambda file: None))
    assert "holds noiseid-result; expected noiseid-dataset" in message(tmp_path / "result.h5")
    (tmp_path / "hollow.h5").write_bytes(hdf5.build("noiseid-dataset", 1, lambda file: None))
    assert "not written by noiseid" in message(tmp_path / "hollow.h5")


def test_a_damaged_file_is_told_with_both_hashes(tmp_path):
    path = tmp_path / "d.h5"
    write_dataset(path, example(20), {})
    bad = bytearray(path.read_bytes())
    expected = hashlib.sha256(bad[: -hdf5._SEAL_SIZE]).hexdigest()
    bad[1000] ^= 1
    path.write_bytes(bad)
    found = hashlib.sha256(bad[: -hdf5._SEAL_SIZE]).hexdigest()
    with pytest.raises(DataError, match=f"damaged.*{expected[:16]}.*{found[:16]}"):
        read_dataset(path)


def test_newer_versions_are_refused_and_older_ones_migrated_step_by_step(tmp_path, monkeypatch):
    path = tmp_path / "d.h5"
    monkeypatch.setattr(dataset_file, "VERSION", 3)
    write_dataset(path, example(20), {})
    monkeypatch.setattr(dataset_file, "VERSION", 1)
    with pytest.raises(DataError, match="version 3; this noiseid reads versions up to 1"):
        read_dataset(path)
    write_dataset(path, example(20), {})
    before = path.read_bytes()

    def rename(word):
        def step(file):
            file.attrs["title"] = file.attrs["title"] + word

        return step

    monkeypatch.setattr(dataset_file, "VERSION", 3)
    monkeypatch.setattr(dataset_file, "MIGRATIONS", {1: rename(" one"), 2: rename(" two")})
    assert read_dataset(path).name == "demo one two"
    assert path.read_bytes() == before
    monkeypatch.setattr(dataset_file, "MIGRATIONS", {2: rename("")})
    with pytest.raises(DataError, match="version 1, which no noiseid has written"):
        read_dataset(path)


def external_link(file, canary):
    file["y"] = h5py.ExternalLink(str(canary), "/secret")


def external_storage(file, canary):
    file.create_dataset("y", (2,), dtype="f8", external=[(str(canary), 0, 16)])


def virtual_dataset(file, canary):
    layout = h5py.VirtualLayout((2,), "f8")
    layout[:] = h5py.VirtualSource(str(canary), "secret", (2,))
    file.create_virtual_dataset("y", layout)


def shape_bomb(file, canary):
    file.create_dataset("y", (10**9, 10), dtype="f8", chunks=(1000, 10), compression="gzip")


def group_cycle(file, canary):
    file.create_group("a")["b"] = file["/"]


@pytest.mark.parametrize(
    "trick", [external_link, external_storage, virtual_dataset, shape_bomb, group_cycle], ids=lambda t: t.__name__
)
def test_a_sealed_file_with_foreign_content_is_refused(tmp_path, trick):
    canary = tmp_path / "canary.h5"
    with h5py.File(canary, "w") as file:
        file["secret"] = np.array([271828.5, 314159.25])
    before = canary.read_bytes()
    memory = io.BytesIO()
    with h5py.File(memory, "w") as file:
        file.attrs["format"], file.attrs["format_version"] = "noiseid-dataset", 1
        trick(file, canary)
    (tmp_path / "bad.h5").write_bytes(memory.getvalue() + hdf5._seal(memory.getvalue()))
    with pytest.raises(DataError, match=r"bad\.h5") as caught:
        read_dataset(tmp_path / "bad.h5")
    assert "271828" not in str(caught.value)
    assert canary.read_bytes() == before
