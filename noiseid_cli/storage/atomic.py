"""Publish a file so that its name only ever shows complete bytes, whoever is killed and whenever."""

from __future__ import annotations

import errno
import hashlib
import itertools
import os
import platform
import time
from contextlib import suppress
from pathlib import Path

from noiseid_cli.errors import DataError, NoiseidError, machine_error

_ADVICE = {
    errno.EACCES: "writing is not permitted there; choose another folder or change its permissions",
    errno.EPERM: "writing is not permitted there; choose another folder or change its permissions",
    errno.ENAMETOOLONG: "the name is too long; choose a shorter one",
    errno.ENOTDIR: "a file stands where a folder is needed; choose another folder",
    errno.EEXIST: "a file stands where a folder is needed; choose another folder",
    errno.EISDIR: "a folder of that name is in the way; move it or choose another name",
    errno.ELOOP: "a link stands in its place; remove it",
}
_DAY = 86400.0
_counter = itertools.count()


def publish(path: Path, data: bytes) -> None:
    """Write ``data`` under ``path``, durably and in one step; missing folders are made.

    The bytes go to a file of their own in the same folder, reach the disk, and only then take the name. A
    reader, or a run after a crash, finds the old file or the new one.

    Args:
        path: name of the file; what stood there is replaced.
        data: the whole content.

    Raises:
        MachineError: the disk is full or faulty.
        DataError: the operating system refused for another reason. In both cases nothing new is left in the folder,
            unless only the last step failed, the sync of the folder: the file is whole then.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.parent / f"{path.name}.{_writer()}-{next(_counter)}.part"
        try:
            _write(part, data)
            os.replace(part, path)  # noqa: PTH105 - one system call, named so that tests can make it fail
        except BaseException:
            with suppress(OSError):
                part.unlink(missing_ok=True)
            raise
        _sync_folder(path.parent)
    except OSError as error:
        raise refused(path, error) from error


def refused(path: Path, error: OSError) -> NoiseidError:
    """What to tell when the operating system does not let a file be written, with what to do about it."""
    said = f"{path} could not be written"
    advice = _ADVICE.get(error.errno or 0, "put that right and run the same command again")
    return machine_error(error, said) or DataError(f"{said}: {error.strerror or error}: {advice}.")


def _write(part: Path, data: bytes) -> None:
    """Create ``part``, which must not exist, and bring ``data`` to the disk in it."""
    handle = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
    try:
        rest = memoryview(data)
        while rest:
            rest = rest[os.write(handle, rest) :]
        os.fsync(handle)
    finally:
        os.close(handle)


def _sync_folder(folder: Path) -> None:
    """Bring the folder's list of names to the disk; without it a power cut may undo the renaming."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # some network file systems know no such thing
            raise
    finally:
        os.close(handle)


def put_aside(path: Path) -> Path:
    """Give a damaged file another name beside its own, ``x.h5.damaged``, so that nothing is lost and its place is free.

    Raises:
        NoiseidError: the operating system refused.
    """
    for number in itertools.count(1):
        aside = path.with_name(f"{path.name}.damaged" + (f"-{number}" if number > 1 else ""))
        if not aside.exists():
            break
    try:
        path.rename(aside)
    except OSError as error:
        said = f"{path} is damaged and could not be put aside"
        raise machine_error(error, said) or DataError(f"{said}: {error.strerror}: move it away.") from error
    return aside


def _machine() -> str:
    """A short name for this machine that suits a file name."""
    return hashlib.sha256(platform.node().encode()).hexdigest()[:8]


def _writer() -> str:
    return f"{_machine()}-{os.getpid()}"


def sweep_parts(folder: Path) -> list[Path]:
    """Remove what killed writers left in ``folder``; return what was removed.

    A part is dead if its writer's process on this machine is gone, or if it is older than a day.
    """
    removed = []
    for part in sorted(Path(folder).glob("*.part")):
        if _is_dead(part):
            with suppress(FileNotFoundError):
                part.unlink()
                removed.append(part)
    return removed


def _is_dead(part: Path) -> bool:
    writer = part.name.removesuffix(".part").rsplit(".", 1)[-1].split("-")
    if len(writer) != 3 or not (writer[1].isdigit() and writer[2].isdigit()):
        return False  # not one of ours
    if writer[0] == _machine() and not _runs(int(writer[1])):
        return True
    try:
        return time.time() - part.stat().st_mtime > _DAY
    except FileNotFoundError:
        return False


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)  # signal 0 only asks whether the process exists
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True
