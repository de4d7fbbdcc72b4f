"""Linear models that are given by their matrices, constant or varying over time.

    next x or dx/dt = A x + B u + G v,  y = C x + D u + e

An entry is a number, or the name of a parameter. Entries that vary over time travel as further inputs of the model,
held over each interval as all inputs are: the kernels know nothing of it, and constant entries cost nothing.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from noiseid_cli.errors import ModelError
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.declarations import Parameter, Quantity
from noiseid_cli.models.equations import Model
from noiseid_cli.models.recording import Array
from noiseid_cli.models.schemes import SCHEMES

LETTERS = ("A", "B", "G", "C", "D")


class MatrixError(ModelError):
    """The matrices of a linear model do not make one.

    Attributes:
        fault: what is wrong, in a sentence.
        letter: the matrix that it is about; empty where it is about several.
    """

    def __init__(self, fault: str, letter: str = "") -> None:
        """Keep both."""
        self.fault, self.letter = fault, letter
        super().__init__(f"linear model: {fault}")


@dataclass(frozen=True)
class MatrixNames:
    """Names and units of a linear model's vectors; what is empty is called x1, u1, v1, y1 and on."""

    states: tuple[Quantity, ...] = ()
    inputs: tuple[Quantity, ...] = ()
    noises: tuple[Quantity, ...] = ()
    outputs: tuple[Quantity, ...] = ()


class MatrixModel(Model):
    """A linear model given by its matrices."""

    matrices: ClassVar[Mapping[str, Any]] = {}
    """(rows, columns) of numbers and names for each letter; of a varying one, symbols of inputs where it varies."""

    @property
    def constant(self) -> bool:
        """All entries are numbers."""
        return not self.parameters and not self.known_inputs

    def dynamics(self, x: Any, u: Any, v: Any, p: Any) -> Any:
        """A x + B u + G v."""
        known = {**_by_name(u), **_by_name(p)}
        driven = [u[q.name] for q in self.driven_inputs]
        parts = ((self.matrices["A"], list(x)), (self.matrices["B"], driven), (self.matrices["G"], list(v)))
        return [sum(_row(M[i], vector, known) for M, vector in parts) for i in range(len(self.states))]

    def output(self, x: Any, u: Any, p: Any) -> Any:
        """C x + D u."""
        known = {**_by_name(u), **_by_name(p)}
        driven = [u[q.name] for q in self.driven_inputs]
        parts = ((self.matrices["C"], list(x)), (self.matrices["D"], driven))
        return [sum(_row(M[i], vector, known) for M, vector in parts) for i in range(len(self.outputs))]

    def key(self) -> str:
        """Hash over constant matrices and the names, which are all that there is: it takes no equations."""
        groups = (self.states, self.inputs, self.noises, self.outputs)
        text = json.dumps(["linear", self.matrices, [[q.name for q in group] for group in groups]])
        return hashlib.sha256(text.encode()).hexdigest()

    def compiled(self) -> CompiledModel:
        """The functions that serve every model of constant matrices, without compilation."""
        from dataclasses import replace

        from noiseid_cli.models.linear import linear_model

        A, B, G, C, D = (np.array(self.matrices[letter], dtype=float) for letter in LETTERS)
        groups = (self.states, self.inputs, self.noises, self.outputs)
        states, inputs, noises, outputs = (tuple(q.name for q in group) for group in groups)
        return replace(
            linear_model(A, G, C, B, D),
            name=self.name,
            states=states,
            inputs=inputs,
            noises=noises,
            outputs=outputs,
            units={q.name: q.unit for group in groups for q in group},
            scheme=SCHEMES[self.discretisation],
        )


def matrix_model(
    matrices: Mapping[str, Any],
    names: MatrixNames | None = None,
    discretisation: str = "discrete",
    sample_time: float = 1.0,
    parameters: Mapping[str, float] | None = None,
) -> MatrixModel:
    """A linear model from its matrices.

    Args:
        matrices: A and C, and where they are not identity (G) or absent (B, D) those too; each rows of numbers and
            names of parameters, or an array (rows, columns), or (samples, rows, columns) where it varies over time.
        names: names and units.
        discretisation: ``discrete``, ``exact``, ``euler`` or ``rk4``.
        sample_time: interval between samples in a simulation, s.
        parameters: a value for each name that stands in a matrix.

    Raises:
        MatrixError: a matrix is missing, the shapes or lengths do not fit each other, a noise drives no state, or a
            name has no value.
    """
    found = _complete(matrices)
    nx, nu, nv, ny = found["A"].shape[-1], found["B"].shape[-1], found["G"].shape[-1], found["C"].shape[-2]
    names = names or MatrixNames()
    groups = {}
    for group, letter, size in (("states", "x", nx), ("inputs", "u", nu), ("noises", "v", nv), ("outputs", "y", ny)):
        given = getattr(names, group)
        if given and len(given) != size:
            raise MatrixError(f"{len(given)} {group} are named, but the matrices have {size}.")
        groups[group] = given or tuple(Quantity(f"{letter}{i + 1}") for i in range(size))
    tables, series = {}, {}
    for letter, M in found.items():
        tables[letter], varying = _constant_part(letter, M)
        series.update(varying)
    _refuse_idle_noise(tables["G"], groups["noises"])
    values = dict(parameters or {})
    used = sorted({e for M in tables.values() for e in M.ravel() if isinstance(e, str)} - set(series))
    if lacking := [name for name in used if name not in values]:
        raise MatrixError(f"{lacking[0]} stands in a matrix and has no value; give it under parameters.")
    attributes = {
        "__doc__": "A linear model given by its matrices.",
        "name": "linear",
        "matrices": {letter: M.tolist() for letter, M in tables.items()},
        **groups,
        "inputs": (*groups["inputs"], *(Quantity(n, "", "entry of a matrix that varies over time") for n in series)),
        "known_inputs": series,
        "parameters": tuple(Parameter(name, float(values[name]), "", "entry of a matrix") for name in used),
        "discretisation": discretisation,
        "sample_time": float(sample_time),
    }
    made: type[MatrixModel] = type("linear", (MatrixModel,), attributes)
    return made(parameters)


def _complete(matrices: Mapping[str, Any]) -> dict[str, Any]:
    """All five matrices as arrays of numbers and names, their shapes and lengths checked."""
    for letter in ("A", "C"):
        if letter not in matrices:
            raise MatrixError(f"the matrix {letter} is missing.")
    found = {letter: _array(letter, M) for letter, M in matrices.items()}
    nx, ny = found["A"].shape[-2], found["C"].shape[-2]
    nu = next((found[letter].shape[-1] for letter in ("B", "D") if letter in found), 0)
    found.setdefault("G", np.eye(nx))
    found.setdefault("B", np.zeros((nx, nu)))
    found.setdefault("D", np.zeros((ny, nu)))
    nv = found["G"].shape[-1]
    expected = {"A": (nx, nx), "B": (nx, nu), "G": (nx, nv), "C": (ny, nx), "D": (ny, nu)}
    for letter, shape in expected.items():
        if found[letter].shape[-2:] != shape:
            raise MatrixError(
                f"{letter} is {_times(found[letter].shape[-2:])}, expected {_times(shape)} "
                f"(A is {_times(found['A'].shape[-2:])}, C {_times(found['C'].shape[-2:])}).",
                letter,
            )
    lengths = {letter: len(M) for letter, M in found.items() if M.ndim == 3}
    if len(set(lengths.values())) > 1:
        told = ", ".join(f"{letter} {length}" for letter, length in lengths.items())
        raise MatrixError(f"the matrices that vary over time differ in length: {told} samples.")
    return {letter: found[letter] for letter in LETTERS}


def _array(letter: str, given: Any) -> Any:
    rows = given.tolist() if isinstance(given, np.ndarray) else given
    mixed = not isinstance(given, np.ndarray) and any(isinstance(e, str) for row in rows for e in row)
    if not isinstance(given, np.ndarray) and len({len(row) for row in rows}) > 1:
        raise MatrixError(f"the rows of {letter} differ in length.", letter)
    M = np.array(rows, dtype=object if mixed else float)
    if M.ndim not in (2, 3) or 0 in M.shape:
        raise MatrixError(
            f"{letter} has the shape {M.shape}; it must be (rows, columns), or (samples, rows, columns).", letter
        )
    if not mixed and not np.isfinite(M).all():
        raise MatrixError(f"{letter} has an entry that is not a finite number.", letter)
    return M


def _constant_part(letter: str, M: Any) -> tuple[Any, dict[str, Array]]:
    """The matrix with the names of inputs where it varies, and the values of those over time."""
    if M.ndim == 2:
        return M.astype(object), {}
    table, series = M[0].astype(object), {}
    for i, j in zip(*np.nonzero(np.ptp(M, axis=0)), strict=True):
        table[i, j] = f"{letter}_{i + 1}_{j + 1}"
        series[table[i, j]] = np.ascontiguousarray(M[:, i, j])
    return table, series


def _refuse_idle_noise(G: Any, noises: Sequence[Quantity]) -> None:
    for j, noise in enumerate(noises):
        if all(entry == 0 for entry in G[:, j]):
            fault = f"column {j + 1} of G is zero: the noise {noise.name} drives no state; leave that column out."
            raise MatrixError(fault, "G")


def _by_name(symbols: Any) -> dict[str, Any]:
    return {str(s): s for s in symbols}


def _row(entries: Sequence[Any], vector: Sequence[Any], known: Mapping[str, Any]) -> Any:
    """One row times a vector; whole numbers stay whole, so that 1 is not shown."""
    import sympy as sp

    terms = []
    for entry, symbol in zip(entries, vector, strict=True):
        if isinstance(entry, str):
            terms.append(known[entry] * symbol)
        elif entry != 0.0:
            whole = float(entry).is_integer() and abs(entry) < 1e6
            terms.append((sp.Integer(int(entry)) if whole else sp.Float(entry)) * symbol)
    return sp.Add(*terms)


def _times(shape: Sequence[int]) -> str:
    return " x ".join(map(str, shape))
