"""What differs between two dataset or result files: every variable compared, wall-clock times left out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from noiseid_cli.errors import DataError
from noiseid_cli.storage import dataset_file, hdf5, result_file

if TYPE_CHECKING:
    import h5py

_TIMES = ("seconds", "estimation_seconds", "unit_seconds")
_TEXTS = ("status", "method", "dataset", "model", "safeguards")


@dataclass(frozen=True)
class Difference:
    """One variable that differs.

    Attributes:
        name: its path in the file, or the name of a text kept with it.
        what: the difference in words.
        absolute, relative: the largest differences of its entries; None where they cannot be compared.
    """

    name: str
    what: str
    absolute: float | None = None
    relative: float | None = None


def file_differences(a: Path, b: Path, rtol: float = 0.0, atol: float = 0.0) -> list[Difference]:
    """Compare two files of noiseid.

    Entries agree if they are equal, both missing, or ``|a - b| <= atol + rtol max(|a|, |b|)``.

    Args:
        a, b: the files.
        rtol, atol: tolerances; without them every bit counts, but for the sign of zero.

    Raises:
        DataError: a file is missing or damaged, or the two are of different kinds.
    """
    kinds = [hdf5.read_format(path) for path in (a, b)]
    if kinds[0] != kinds[1]:
        raise DataError(f"{a} holds a {kinds[0]} and {b} a {kinds[1]}: only files of one kind can be compared.")
    (texts_a, arrays_a), (texts_b, arrays_b) = (_content(path, kinds[0]) for path in (a, b))
    out = [
        Difference(name, f"{texts_a.get(name, 'nothing')} / {texts_b.get(name, 'nothing')}")
        for name in _TEXTS
        if texts_a.get(name) != texts_b.get(name)
    ]
    for name in sorted(arrays_a.keys() | arrays_b.keys()):
        if name not in arrays_a or name not in arrays_b:
            out.append(Difference(name, f"only in {a if name in arrays_a else b}"))
        elif (found := _compare(name, arrays_a[name], arrays_b[name], rtol, atol)) is not None:
            out.append(found)
    return out


def _content(path: Path, kind: str) -> tuple[dict[str, str], dict[str, Any]]:
    module: Any = result_file if kind == result_file.FORMAT else dataset_file
    arrays: dict[str, Any] = {}

    def keep(name: str, item: Any) -> None:
        if hasattr(item, "shape") and name.rsplit("/", 1)[-1] not in _TIMES:
            arrays[name] = item[()]

    def read(file: h5py.File) -> dict[str, str]:
        file.visititems(keep)
        return hdf5.text_attributes(file)

    with hdf5.opened(path, module.FORMAT, module.VERSION, module.MIGRATIONS) as file:
        return read(file), arrays


def _compare(name: str, a: Any, b: Any, rtol: float, atol: float) -> Difference | None:
    a, b = np.asarray(a), np.asarray(b)
    if a.shape != b.shape:
        return Difference(name, f"shape {a.shape} / {b.shape}")
    if a.dtype.kind not in "fiu" or b.dtype.kind not in "fiu":
        return None if a.tolist() == b.tolist() else Difference(name, "other entries")
    a, b = a.astype(float), b.astype(float)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        gap, size = np.abs(a - b), np.maximum(np.abs(a), np.abs(b))
        same = (a == b) | (np.isnan(a) & np.isnan(b)) | (gap <= atol + rtol * size)
        if np.all(same):
            return None
        apart = ~same
        absolute = float(np.max(gap[apart], initial=0.0))
        relative = float(np.max(gap[apart] / size[apart], initial=0.0))
    words = f"{int(apart.sum())} of {a.size} entries"
    if not np.isfinite(absolute):
        return Difference(name, words + ", some only in one of the two")
    return Difference(name, words, absolute, relative)
