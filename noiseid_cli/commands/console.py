"""What a command says, and how it ends: stdout is the answer, stderr is talk, errors have exit codes."""

from __future__ import annotations

import functools
import json
import os
import shutil
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import typer

from noiseid_cli.errors import NoiseidError

F = TypeVar("F", bound=Callable[..., Any])

BUG, UNFINISHED, INTERRUPTED = 1, 4, 130


def answer(text: str) -> None:
    """Print part of the answer on stdout."""
    typer.echo(text)


def answer_json(data: Any) -> None:
    """Print the answer as JSON on stdout; what is not a number becomes null."""
    typer.echo(json.dumps(_finite(data), indent=2, ensure_ascii=False))


def say(text: str) -> None:
    """Print talk on stderr."""
    typer.echo(text, err=True)


def width() -> int:
    """Columns of the terminal; 100 where there is none."""
    return shutil.get_terminal_size((100, 24)).columns


def guarded(command: F) -> F:
    """Turn whatever a command raises into a message and an exit code; never a traceback on the screen."""

    @functools.wraps(command)
    def wrapper(*args: Any, **kwargs: Any) -> Any:
        try:
            return command(*args, **kwargs)
        except NoiseidError as error:
            for line in str(error).splitlines():
                say(line if line.startswith(" ") else f"noiseid: {line}")
            raise typer.Exit(error.exit_code) from None
        except KeyboardInterrupt:
            say("noiseid: interrupted; what is finished is kept. The same command goes on from there.")
            raise typer.Exit(INTERRUPTED) from None
        except BrokenPipeError:
            # The reader of our output has gone (as in `noiseid models | head`): nothing is left to say.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise typer.Exit(0) from None
        except (typer.Exit, typer.Abort, typer.BadParameter):
            raise
        except Exception:  # whatever else is raised is a bug of ours
            say(f"noiseid: internal error: {_last_line()}; please report it with {_log()}")
            raise typer.Exit(BUG) from None

    return wrapper  # type: ignore[return-value]


def _last_line() -> str:
    return traceback.format_exc().strip().splitlines()[-1]


def _log() -> Path:
    """Write the traceback to a file of its own and give its path."""
    from platformdirs import user_log_path

    folder = user_log_path("noiseid", ensure_exists=True)
    path = folder / f"error-{os.getpid()}.log"
    path.write_text(f"{' '.join(sys.argv)}\n\n{traceback.format_exc()}")
    return path


def _finite(data: Any) -> Any:
    if isinstance(data, float):
        return data if abs(data) < float("inf") else None
    if isinstance(data, dict):
        return {key: _finite(value) for key, value in data.items()}
    return [_finite(value) for value in data] if isinstance(data, list | tuple) else data
