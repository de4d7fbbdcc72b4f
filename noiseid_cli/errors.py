"""The errors that noiseid raises on purpose, each with the exit code it ends a command with."""

from __future__ import annotations

import errno
from dataclasses import dataclass


class NoiseidError(Exception):
    """A fault that the user can act on; its text says what is wrong and what to do."""

    exit_code = 3


class DataError(NoiseidError):
    """A recording or a file of ours cannot be used as it is."""


class DamagedError(DataError):
    """A file under one of our names does not hold what was written there; it can be put aside and made anew."""


class ModelError(NoiseidError):
    """A model is not known, cannot be loaded or has faulty equations."""


class EstimationError(NoiseidError):
    """A method cannot be run on this problem (not: it ran and did not converge)."""


class MachineError(NoiseidError):
    """The machine failed: a disk that is full or faulty, a cluster that is lost. What is finished is kept."""

    exit_code = 1


_MACHINE = {
    errno.ENOSPC: "the disk is full; free some space and run the same command again",
    errno.EDQUOT: "the disk quota is used up; free some space and run the same command again",
    errno.EIO: "the disk reports a fault; check it, then run the same command again",
    errno.EROFS: "that file system is read-only; choose another folder",
}


NO_MEMORY = "there is not enough memory: take fewer samples or fewer --jobs, or end other programs"


def machine_error(error: BaseException, said: str = "") -> MachineError | None:
    """What to raise for a fault of the machine; None where the operating system refused for another reason.

    Args:
        error: what was raised.
        said: what could not be done, such as ``x.h5 could not be written``; default: the file that it was about.
    """
    if isinstance(error, MachineError):
        return error
    if isinstance(error, MemoryError):
        return MachineError(NO_MEMORY)
    if not isinstance(error, OSError) or error.errno not in _MACHINE:
        return None
    said = said or f"{error.filename or 'the output or a file'} could not be read or written"
    return MachineError(f"{said}: {error.strerror}: {_MACHINE[error.errno]}.")


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong with a text file, with its place.

    Attributes:
        line: line number, from 1.
        column: column number, from 1.
        path: the setting in dotted form, such as ``simulate.samples``; empty for the file as a whole.
        message: what is wrong and what is allowed.
        excerpt: the line itself, as it stands in the file.
        source: what set it, where that is not the file, such as ``--set seed=3``.
    """

    line: int
    column: int
    path: str
    message: str
    excerpt: str = ""
    source: str = ""


class ConfigError(NoiseidError):
    """An experiment file is wrong; carries every problem that was found."""

    def __init__(self, file: str, problems: list[Problem]) -> None:
        """Keep the file's name and all problems, ordered by place."""
        self.file = file
        self.problems = sorted(problems, key=lambda p: (p.line, p.column))
        super().__init__("\n".join(self.lines()))

    def lines(self) -> list[str]:
        """Render each problem as ``file:line:column: path: message``, with the line it is on below."""
        out = []
        for p in self.problems:
            where = f"{p.source}: " if p.source else f"{self.file}:{p.line}:{p.column}: "
            out.append(where + (f"{p.path}: " if p.path else "") + p.message)
            if p.excerpt:
                out.append(f"    {p.excerpt.rstrip()}")
                out.append("    " + " " * (p.column - 1) + "^")
        return out
