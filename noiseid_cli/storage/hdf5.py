"""HDF5 files built in memory and sealed by a checksum, so that damage is found before a number is used.

The seal is one line of text behind the HDF5 image. HDF5 reads nothing behind its own end of file, so xarray,
MATLAB, Julia and h5dump open a sealed file as it is.
"""

from __future__ import annotations

import hashlib
import io
import stat
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from noiseid_cli.errors import DamagedError, DataError, machine_error

if TYPE_CHECKING:
    import h5py

MAGIC = b"\x89HDF\r\n\x1a\n"
_SEAL = "\nnoiseid sha256 {} of {:020d} bytes\n"
_SEAL_SIZE = len(_SEAL.format("0" * 64, 0))
_AGAIN = "The command that made it puts it aside and makes it anew, and no other file"
# Deflate cannot shrink more than 1032 times: a file that declares more than this was not written by noiseid.
_MAX_RATIO = 1032

Migration = Callable[["h5py.File"], None]
"""Turns an open file (in memory, writable) of one format version into the next."""


def build(file_format: str, version: int, fill: Callable[[h5py.File], None]) -> bytes:
    """The bytes of a sealed HDF5 file; the same content gives the same bytes.

    Args:
        file_format: what kind of file this is, such as ``noiseid-dataset``.
        version: version of that format.
        fill: writes the content into the open file.
    """
    import h5py

    memory = io.BytesIO()
    # v108 is the oldest layout with checksummed metadata and attributes above 64 kB: the most programs read it.
    with h5py.File(memory, "w", libver=("v108", "v108"), track_order=True) as file:
        file.attrs["format"] = file_format
        file.attrs["format_version"] = version
        fill(file)
    image = memory.getvalue()
    return image + _seal(image)


def _seal(image: bytes) -> bytes:
    return _SEAL.format(hashlib.sha256(image).hexdigest(), len(image)).encode()


@contextmanager
def opened(path: Path, file_format: str, version: int, migrations: Mapping[int, Migration]) -> Iterator[h5py.File]:
    """Open a sealed file for reading, checked and in the current version.

    Args:
        path: the file.
        file_format: the format it must have.
        version: the current version of that format.
        migrations: for each older version, the step to the next one.

    Raises:
        DataError: the file is missing, damaged, of another program, of another format or too new.
    """
    import h5py

    image = _verified(Path(path), file_format)
    try:
        # Writable only because a migration may change the copy in memory; the file itself stays as it is.
        with h5py.File(io.BytesIO(image), "r+" if migrations else "r") as file:
            _check_format(path, file, file_format, version, migrations)
            _refuse_foreign_data(path, file, len(image))
            yield file
    except (OSError, KeyError, RuntimeError, ValueError, TypeError, UnicodeDecodeError) as error:
        raise DamagedError(
            f"{path} carries noiseid's checksum, but its content is not that of a {file_format} file "
            f"({type(error).__name__}: {error}). It was not written by noiseid. {_AGAIN}."
        ) from error


def read_format(path: Path) -> str:
    """What kind of sealed file this is, such as ``noiseid-dataset``.

    Raises:
        DataError: the file is missing, damaged or of another program.
    """
    import h5py

    with h5py.File(io.BytesIO(_verified(Path(path), "noiseid")), "r") as file:
        return str(file.attrs.get("format", "no format at all"))


def _verified(path: Path, file_format: str) -> bytes:
    """The HDF5 image in ``path``, after its checksum has been found right."""
    data = _bytes_of(path, file_format)
    if not data:
        raise DamagedError(
            f"{path} is empty; expected a {file_format} file. The disk may have been full when it was copied. {_AGAIN}."
        )
    if not data.startswith(MAGIC):
        raise DamagedError(
            f"{path} is not an HDF5 file: it begins with {data[:8]!r}; expected a {file_format} file. "
            "Check the name; a log file of your own is read by `noiseid import`."
        )
    image, seal = data[:-_SEAL_SIZE], data[-_SEAL_SIZE:]
    if seal == _seal(image):
        return image
    words = seal.split()
    if words[:2] != [b"noiseid", b"sha256"] or not seal.endswith(b" bytes\n"):
        raise DamagedError(
            f"{path} ({len(data)} bytes) does not end in noiseid's checksum: it was cut short, or another "
            f"program wrote it; expected a {file_format} file. {_AGAIN}. "
            "An HDF5 file of your own is read by `noiseid import`."
        )
    expected = words[2].decode("ascii", "replace")
    found = hashlib.sha256(image).hexdigest()
    raise DamagedError(
        f"{path} is damaged: its SHA-256 should be {expected[:16]}... and is {found[:16]}... "
        f"({len(image)} bytes). {_AGAIN}."
    )


def _bytes_of(path: Path, file_format: str) -> bytes:
    try:
        mode = path.stat().st_mode
        if stat.S_ISDIR(mode):
            raise DataError(f"{path} is a folder; expected a {file_format} file. Name the file in it.")
        if not stat.S_ISREG(mode):  # opening a pipe would wait for ever
            raise DataError(f"{path} is a pipe or a device; expected a {file_format} file. Name a plain file.")
        return path.read_bytes()
    except FileNotFoundError as error:
        raise DataError(f"{path} does not exist; expected a {file_format} file. Check the name.") from error
    except OSError as error:
        said = f"{path} cannot be read"
        raise machine_error(error, said) or DataError(f"{said}: {error.strerror}. Check its permissions.") from error


def _check_format(
    path: Path, file: h5py.File, file_format: str, version: int, migrations: Mapping[int, Migration]
) -> None:
    found = file.attrs.get("format", "no format at all")
    if found != file_format:
        raise DataError(f"{path} holds {found}; expected {file_format}. Check the name.")
    at = int(file.attrs["format_version"])
    if at > version:
        raise DataError(
            f"{path} is {file_format} version {at}; this noiseid reads versions up to {version}. "
            "Install a newer noiseid."
        )
    for step in range(at, version):
        if step not in migrations:
            raise DataError(f"{path} is {file_format} version {at}, which no noiseid has written. {_AGAIN}.")
        migrations[step](file)


def _refuse_foreign_data(path: Path, file: h5py.File, size: int) -> None:
    """Refuse what noiseid never writes: data in other files, and sizes that the file cannot hold."""
    import h5py

    def check(group: h5py.Group) -> None:
        for name in group:
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                raise DamagedError(f"{path}: {name} is a link, and noiseid writes none. {_AGAIN}.")
            item = group[name]
            if isinstance(item, h5py.Group):
                check(item)
            elif item.external or item.is_virtual:
                raise DamagedError(f"{path}: {name} keeps its data in another file. {_AGAIN}.")
            elif item.nbytes > _MAX_RATIO * size:
                raise DamagedError(f"{path}: {name} declares {item.nbytes} bytes, more than it can hold. {_AGAIN}.")

    check(file)


def text_attributes(file: h5py.File) -> dict[str, str]:
    """All attributes of the file's root as texts."""
    return {name: str(value) for name, value in file.attrs.items()}


def set_attributes(target: Any, attributes: Mapping[str, Any], taken: frozenset[str] = frozenset()) -> None:
    """Set attributes on a file, group or dataset, in the given order.

    Raises:
        DataError: a name is in ``taken``, or a text holds a NUL character, which HDF5 would cut off.
    """
    for name, value in attributes.items():
        if name in taken:
            raise DataError(f"The attribute '{name}' belongs to the file format itself; choose another name.")
        if "\0" in name or (isinstance(value, str) and "\0" in value):
            raise DataError(f"The attribute '{name}' holds a NUL character, which HDF5 cannot keep.")
        target.attrs[name] = value
