"""One run at a time in the folder of an experiment.

The lock is the operating system's (flock): it ends with the process that holds it, however that ends, so that none is
ever left behind. The file that carries it stays; its text says who holds it, for people.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import platform
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from noiseid_cli.errors import DataError
from noiseid_cli.storage.atomic import refused

NAME = ".lock"
_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL)


@contextmanager
def locked(folder: Path, say: Callable[[str], None], wait: bool = False, name: str = NAME) -> Iterator[None]:
    """Hold the lock of a folder, which is made where it is missing.

    Args:
        folder: the experiment's folder.
        say: takes the sentence that somebody else holds it, before a wait, or that the file system knows no locks.
        wait: wait until the lock is free.
        name: name of the file, for a lock on a part of the work.

    Raises:
        NoiseidError: another run holds it, or the folder cannot be written.
    """
    path = Path(folder) / name
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # Never truncated on opening: the text is the holder's until the lock is ours.
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
    except OSError as error:
        raise refused(path, error) from error
    try:
        if _take(handle, path, say, wait):
            _sign(handle)
        yield
    finally:
        os.close(handle)


def holder(folder: Path) -> str:
    """Who holds the lock of a folder, in words; empty if nobody does. Changes nothing there."""
    path = Path(folder) / NAME
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW)
    except OSError:  # nobody has ever worked there, or it is not ours to see
        return ""
    try:
        # Shared, and let go at once: of two that look, neither finds the other.
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return _holder(path)
    except OSError:
        return ""
    else:
        return ""
    finally:
        os.close(handle)


def _take(handle: int, path: Path, say: Callable[[str], None], wait: bool) -> bool:
    """Take the lock; False where the file system has none."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        holder = _holder(path)
        if not wait:
            raise DataError(
                f"{path.parent} is in use by {holder}: wait for it with --wait, or take another folder with --out."
            ) from None
        say(f"Waiting for {holder}.")
        fcntl.flock(handle, fcntl.LOCK_EX)
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise DataError(f"{path} cannot be locked: {error.strerror}.") from error
        say(f"The file system of {path.parent} knows no locks: do not start two runs there at once.")
        return False
    return True


def _sign(handle: int) -> None:
    """Write down who holds the lock. A disk that is full must not keep anybody from trying."""
    facts = {
        "process": os.getpid(),
        "machine": platform.node(),
        "since": time.strftime("%Y-%m-%d %H:%M:%S"),
    }
    try:
        os.ftruncate(handle, 0)
        os.pwrite(handle, json.dumps(facts).encode(), 0)
    except OSError:
        return


def _holder(path: Path) -> str:
    """Who holds the lock, in words."""
    try:
        facts = json.loads(path.read_text(encoding="utf-8"))
        return f"process {int(facts['process'])} on {_plain(facts['machine'])} since {_plain(facts['since'])}"
    except (OSError, ValueError, KeyError, TypeError):
        return "another run"


def _plain(text: object) -> str:
    """At most 80 printable characters: the file may be anybody's."""
    return "".join(c for c in str(text) if c.isprintable())[:80]
