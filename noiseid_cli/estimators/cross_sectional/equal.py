"""Tests whose covariances, gains and their derivatives are the same: these do not depend on the data."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np

from noiseid_cli.estimators.cross_sectional.problem import CrossSection
from noiseid_cli.models.parametric import ParametricMatrices
from noiseid_cli.models.recording import Array, Recording

BLOCK = 64
"""So many tests at most go through one filter, whose columns then stay in the processor's cache [chosen]."""


@dataclass(frozen=True)
class EqualTests:
    """Tests of equal matrices, length, map T and missing outputs; ``which`` are their numbers."""

    which: list[int]
    matrices: ParametricMatrices
    recordings: tuple[Recording, ...]
    T: Array


def equal_tests(tests: CrossSection, alpha: Array) -> list[EqualTests]:
    """The tests at alpha in groups that one filter serves; the grouping is the same on every machine."""
    matrices: dict[int, ParametricMatrices] = {}
    keys: dict[int, bytes] = {}
    groups: dict[tuple[bytes, ...], list[int]] = {}
    for i, recording in enumerate(tests.recordings):
        m = matrices[i] = tests.matrices(i, alpha)
        # A family that keeps its matrices gives the same object again: it is read once.
        key = keys.setdefault(id(m), b"" if id(m) in keys else _content(m))
        missing = np.isnan(recording.y)
        shape = np.array(missing.shape).tobytes()
        groups.setdefault((key, tests.maps[i].tobytes(), shape, missing.tobytes()), []).append(i)
    return [
        EqualTests(which, matrices[which[0]], tuple(tests.recordings[i] for i in which), tests.maps[which[0]])
        for group in groups.values()
        for which in _blocks(group)
    ]


def _blocks(group: list[int]) -> Iterator[list[int]]:
    for first in range(0, len(group), BLOCK):
        yield group[first : first + BLOCK]


def _content(m: ParametricMatrices) -> bytes:
    """All entries, with the lengths of the time axes."""
    arrays = [getattr(m, field.name) for field in fields(m)]
    return repr([a.shape for a in arrays]).encode() + b"".join(a.tobytes() for a in arrays)
