"""Where compiled code is kept, so that it is compiled once on a machine."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from noiseid_cli.errors import ModelError, machine_error


def cache_root() -> Path:
    """Folder of all that noiseid compiles: NOISEID_CACHE_DIR if set, else the user's cache folder."""
    chosen = os.environ.get("NOISEID_CACHE_DIR")
    if chosen:
        return Path(chosen).expanduser().absolute()
    import platformdirs

    return Path(platformdirs.user_cache_dir("noiseid"))


def place_kernels(package: Path) -> None:
    """Choose where numba keeps compiled kernels; called before numba is imported.

    They stand beside the source, where numba puts them by itself. Where that cannot be written (an installation for
    all users, a container), they go to the cache folder. NUMBA_CACHE_DIR, where it is set, is left to the user.

    Args:
        package: folder of the package.

    Raises:
        ModelError: there is no folder that can be written.
        MachineError: there is none because the disk is full, faulty or read-only.
    """
    if os.environ.get("NUMBA_CACHE_DIR") or _refusal(package / "models" / "__pycache__") is None:
        return
    folder = cache_root() / "kernels"
    if error := _refusal(folder):
        said = f"compiled kernels can be kept neither in {package} nor in {folder}"
        advice = "set NOISEID_CACHE_DIR to a folder that you can write to"
        raise machine_error(error, f"{said} ({advice})") or ModelError(f"{said}: {advice}.")
    os.environ["NUMBA_CACHE_DIR"] = str(folder)


def _refusal(folder: Path) -> OSError | None:
    """Why no file can be made in a folder, which is made itself if need be; None where one can."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return None
    except OSError as error:
        return error
