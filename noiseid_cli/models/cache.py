"""Where compiled code is kept, so that it is compiled once on a machine."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

from noiseid_cli.errors import ModelError, machine_error


def cache_root() -> Path:
    """Folder of all that noiseid compiles: NOISEID_CACHE_DIR if set, else the user's cache folder."""
    chosen = os.environ.get("NOISEID_CACHE_DIR")
    if chosen:
        return Path(chosen).expanduser().absolute()
    import platformdirs

    return Path(platformdirs.user_cache_dir("noiseid"))


def place_kernels(package: Path) -> None:
    """Choose where numba keeps compiled kernels; called before any is declared.

    One that cannot be kept after all, because the disk is full, is used all the same: ``unkept`` tells of it.

    Args:
        package: folder of the package.

    Raises:
        ModelError, MachineError: as in ``kernel_folder``.
    """
    folder = kernel_folder(package)
    if folder is not None:
        os.environ["NUMBA_CACHE_DIR"] = str(folder)
    from numba.core import config, event

    config.reload_config()  # somebody may have imported numba before

    class Keeper(event.Listener):
        def on_start(self, event: Any) -> None:
            dispatcher = event.data["dispatcher"]
            if dispatcher.py_func.__module__.startswith(("noiseid_cli.", "noiseid_model_")):
                _go_on_unkept(dispatcher._cache)

        def on_end(self, event: Any) -> None:
            """Nothing: the function is kept after this."""

    event.register("numba:compile", Keeper())


def kernel_folder(package: Path) -> Path | None:
    """Where compiled kernels go: the cache folder, or None for where numba puts them by itself.

    They stand beside the source. Where that cannot be written (an installation for all users, a container), they go to
    the cache folder. NUMBA_CACHE_DIR, where it is set, is left to the user.

    Raises:
        ModelError: there is no folder that can be written.
        MachineError: there is none because the disk is full, faulty or read-only.
    """
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        if error := _refusal(Path(chosen)):
            said, advice = f"compiled kernels cannot be kept in {chosen}", "set NUMBA_CACHE_DIR to another folder"
            raise machine_error(error, f"{said} ({advice})") or ModelError(f"{said}: {error.strerror}; {advice}.")
        return None
    if _refusal(package / "models" / "__pycache__") is None:
        return None
    folder = cache_root() / "kernels"
    if error := _refusal(folder):
        said = f"compiled kernels can be kept neither in {package} nor in {folder}"
        advice = "set NOISEID_CACHE_DIR to a folder that you can write to"
        raise machine_error(error, f"{said} ({advice})") or ModelError(f"{said}: {advice}.")
    return folder


_unkept: list[str] = []


def unkept() -> str:
    """Which compiled functions of this process could not be kept, and why; empty if all could."""
    return _unkept[0] if _unkept else ""


def _go_on_unkept(cache: Any) -> None:
    """Have a compiled function's cache note that it cannot save, where numba would end the program."""
    if cache.cache_path is None or "save_overload" in vars(cache):
        return
    save = cache.save_overload

    def attempt(signature: Any, compiled: Any) -> None:
        try:
            save(signature, compiled)
        except OSError as error:
            folder = os.environ.get("NUMBA_CACHE_DIR") or cache.cache_path
            _unkept.append(
                f"Compiled kernels cannot be kept in {folder} ({error.strerror}), so that the next run compiles them "
                "again; NUMBA_CACHE_DIR takes another folder."
            )

    cache.save_overload = attempt


def _refusal(folder: Path) -> OSError | None:
    """Why no file can be made in a folder, which is made itself if need be; None where one can."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return None
    except OSError as error:
        return error
