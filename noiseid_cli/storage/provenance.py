"""What a number depends on besides the experiment: versions, machine, linear algebra."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from noiseid_cli import __version__

_PACKAGES = ("numpy", "scipy", "numba", "sympy", "h5py")


def provenance(time: str = "") -> dict[str, str]:
    """Name and version of whatever the numbers depend on.

    Args:
        time: when this is recorded, such as an ISO 8601 time in UTC. It is the caller's: without it the answer,
            and a file that keeps it, is the same at any time.
    """
    facts = {"noiseid": __version__, "python": platform.python_version()}
    facts |= {package: _version(package) for package in _PACKAGES}
    facts |= {
        "platform": platform.platform(),
        "cpu": _cpu(),
        "cpu_count": str(os.cpu_count()),
        "blas": _blas(),
    }
    return facts | ({"time": time} if time else {})


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def _cpu() -> str:
    """The processor's model; the architecture where the system does not tell."""
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def _blas() -> str:
    """Name and version of the linear algebra library that numpy was built with."""
    import numpy as np

    blas = np.show_config(mode="dicts")["Build Dependencies"]["blas"]
    return f"{blas.get('name', 'unknown')} {blas.get('version', '')}".strip()
