"""What a command says, and how it ends: stdout is the answer, stderr is talk, errors have exit codes."""

from __future__ import annotations

import functools
import json
import os
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, TextIO, TypeVar

import typer

from noiseid_cli.commands.text import visible, wrapped
from noiseid_cli.errors import ConfigError, MachineError, NoiseidError, machine_error

F = TypeVar("F", bound=Callable[..., Any])

BUG, FAULTY, UNFINISHED, DIFFERENT, SIGNALLED = 1, 3, 4, 5, 128


class Stopped(KeyboardInterrupt):
    """The process was asked to end; the argument is the signal."""


def answer(text: str) -> None:
    """Print part of the answer on stdout."""
    typer.echo(text)


def answer_json(data: Any) -> None:
    """Print the answer as JSON on stdout; what is not a number becomes null."""
    typer.echo(json.dumps(_finite(data), indent=2, ensure_ascii=False))


def say(text: str) -> None:
    """Print talk on stderr; on a terminal wrapped at its width. What comes from files cannot steer the terminal."""
    text = visible(text)
    typer.echo(wrapped(text, width(sys.stderr)) if sys.stderr.isatty() else text, err=True)


def complain(text: str) -> None:
    """Print what went wrong on stderr."""
    say(f"noiseid: {text}")


def width(stream: Any = None) -> int:
    """Columns of the terminal that a stream (default: stdout) goes to; 100 where it goes to none."""
    if "COLUMNS" in os.environ:
        return shutil.get_terminal_size((100, 24)).columns
    try:
        return os.get_terminal_size((stream or sys.stdout).fileno()).columns or 100
    except (OSError, ValueError):
        return 100


def guarded(command: F) -> F:
    """Turn whatever a command raises into a message and an exit code; never a traceback on the screen."""

    @functools.wraps(command)
    def wrapper(*args: Any, **kwargs: Any) -> Any:
        try:
            return command(*args, **kwargs)
        except ConfigError as error:
            # Bare, so that an editor finds `file:line:column:` at the beginning of a line.
            say(str(error))
            mistakes = f"{len(error.problems)} mistakes" if len(error.problems) > 1 else "a mistake"
            complain(f"{mistakes} in {error.file}; nothing was done")
            raise typer.Exit(error.exit_code) from None
        except NoiseidError as error:
            complain(str(error))
            raise typer.Exit(error.exit_code) from None
        except KeyboardInterrupt as stop:
            number = stop.args[0] if isinstance(stop, Stopped) else signal.SIGINT
            word = "interrupted" if number == signal.SIGINT else f"stopped by {signal.Signals(number).name}"
            complain(f"{word}; what is finished is kept, and the same command goes on from there")
            raise typer.Exit(SIGNALLED + number) from None
        except BrokenPipeError:
            # The reader of our output has gone (as in `noiseid models | head`): nothing is left to say.
            _silence(sys.stdout)
            raise typer.Exit(0) from None
        except (typer.Exit, typer.Abort, typer.BadParameter):
            raise
        except Exception as error:
            fault = _fault_of_stdout() or machine_error(error)
            try:
                complain(str(fault) if fault else _bug(error))
            except OSError:  # stderr may lead to the same full disk
                _silence(sys.stderr)
            raise typer.Exit(MachineError.exit_code if fault else BUG) from None

    return wrapper  # type: ignore[return-value]


def stop_on_signals() -> None:
    """End as on Ctrl-C, with workers ended and the terminal put right, when asked to by a signal."""

    def stop(number: int, _: Any) -> None:
        raise Stopped(number)

    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, stop)


def _silence(stream: TextIO) -> None:
    """Lead a stream to nowhere: what is left in its buffer would fail once more when Python ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _fault_of_stdout() -> MachineError | None:
    """The fault of the machine that keeps the answer from being written, as in `noiseid schema > /full/disk`."""
    try:
        sys.stdout.flush()
    except OSError as error:
        _silence(sys.stdout)
        return machine_error(error, "the output could not be written")
    return None


def _bug(error: Exception) -> str:
    """What is said of a bug of ours: its last line, and where the traceback is kept."""
    last = "".join(traceback.format_exception(error)).strip().splitlines()[-1]
    log = _log()
    with_what = f"please report it with {log}" if log else "please report it; no log file could be written"
    return f"internal error: {last}; {with_what}"


def _log() -> Path | None:
    """Write the traceback to a file of its own and give its path; None where none can be written."""
    from platformdirs import user_log_path

    name = f"error-{time.strftime('%Y%m%d-%H%M%S')}-{os.getpid()}.log"
    text = f"{' '.join(sys.argv)}\n\n{traceback.format_exc()}"
    with suppress(OSError):  # a read-only home must not hide the bug
        path = user_log_path("noiseid", ensure_exists=True) / name
        path.write_text(text, encoding="utf-8")
        return path
    with suppress(OSError):
        path = Path(tempfile.gettempdir()) / f"noiseid-{name}"
        path.write_text(text, encoding="utf-8")
        return path
    return None


def _finite(data: Any) -> Any:
    if isinstance(data, float):
        return data if abs(data) < float("inf") else None
    if isinstance(data, dict):
        return {key: _finite(value) for key, value in data.items()}
    return [_finite(value) for value in data] if isinstance(data, list | tuple) else data
