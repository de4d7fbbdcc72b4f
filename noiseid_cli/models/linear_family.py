"""From a linear model's equations to its matrices as functions of some of its parameters, with their derivatives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from noiseid_cli.errors import ModelError
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.equations import Model
from noiseid_cli.models.linear import linear_model
from noiseid_cli.models.parametric import ParametricMatrices, discretise
from noiseid_cli.models.recording import Array, Recording

Rates = Callable[[Array], tuple[list[Array], list[Array]]]
"""From all parameter values to F, L, G, C, D, S_a and to their derivatives, the parameter in front."""

KEPT = 4096
"""Steps that are kept: tests of one ensemble share them, and so do the evaluations at one alpha."""


@dataclass(frozen=True)
class LinearFamily:
    """The matrices of one test of a linear model at given alpha.

    Alpha holds the model's parameters ``names``, then the variances ``process`` on the diagonal of Q, then the
    variances ``measurement`` on the diagonal of R.

    Attributes:
        model: affine in x, u and v without a constant term, its coefficients functions of the parameters.
        names: the parameters in alpha.
        Q: (nv, nv) covariance of the process noise: per sample, or a spectral density where the model is discretised
            by ``van_loan``. R: (ny, ny) covariance of the measurement noise.
        process, measurement: indices of the variances in alpha.
        density: Q of a noise that is held over each interval is a density: its covariance is Q / dt.
    """

    model: Model
    names: tuple[str, ...]
    Q: Array
    R: Array
    process: tuple[int, ...] = ()
    measurement: tuple[int, ...] = ()
    density: bool = False

    @cached_property
    def _rates(self) -> Rates:
        return _rates(self.model, self.names)

    @cached_property
    def _steps(self) -> dict[tuple[bytes, float], tuple[Array, ...]]:
        return {}

    @cached_property
    def _constant(self) -> dict[tuple[bytes, float], ParametricMatrices]:
        return {}

    @property
    def start(self) -> Array:
        """(na,) alpha at the values of the model, Q and R."""
        own = [self.model.values[name] for name in self.names]
        return np.array([*own, *np.diag(self.Q)[list(self.process)], *np.diag(self.R)[list(self.measurement)]])

    def noise(self, alpha: Array) -> tuple[Array, Array]:
        """Q and R at alpha."""
        Q, R = self.Q.copy(), self.R.copy()
        first = len(self.names)
        for k, i in enumerate(self.process):
            Q[i, i] = alpha[first + k]
        for k, i in enumerate(self.measurement):
            R[i, i] = alpha[first + len(self.process) + k]
        return Q, R

    def __call__(self, alpha: Array, recording: Recording) -> ParametricMatrices:
        """The matrices of one test; equal intervals are discretised once, and equal constant tests share the object."""
        # A test of one sample has no interval; any will do.
        intervals, index = np.unique(recording.dt if len(recording.dt) else [1.0], return_inverse=True)
        if len(intervals) > 1:
            return self._assembled(alpha, intervals, index)
        key = (np.asarray(alpha, dtype=float).tobytes(), float(intervals[0]))
        if key not in self._constant:
            if len(self._constant) >= KEPT:
                self._constant.clear()
            self._constant[key] = self._assembled(alpha, intervals, index)
        return self._constant[key]

    def _assembled(self, alpha: Array, intervals: Array, index: NDArray[np.intp]) -> ParametricMatrices:
        """The matrices over a test whose intervals are ``intervals[index]``."""
        steps = [self._step(alpha, float(dt)) for dt in intervals]
        A, B, Q, dA, dB, dQ = (np.stack([s[i] for s in steps], axis=0 if i < 3 else 1) for i in range(6))
        if len(intervals) > 1:
            A, B, Q, dA, dB, dQ = A[index], B[index], Q[index], dA[:, index], dB[:, index], dQ[:, index]
        (_, _, _, C, D, S_a), (_, _, _, dC, dD, dS_a) = self._values(alpha)
        _, R = self.noise(alpha)
        dR = np.zeros((len(alpha), *R.shape))
        for k, i in enumerate(self.measurement):
            dR[len(self.names) + len(self.process) + k, i, i] = 1.0
        return ParametricMatrices(
            A, B, Q, C[None], D[None], R[None], S_a, dA, dB, dQ, dC[:, None], dD[:, None], dR[:, None], dS_a
        )

    def _values(self, alpha: Array) -> tuple[list[Array], list[Array]]:
        """F, L, G, C, D, S_a at alpha with derivatives in all of alpha."""
        p = self.model.vector
        order = list(self.model.values)
        for name, value in zip(self.names, alpha, strict=False):
            p[order.index(name)] = value
        values, slopes = self._rates(p)
        rest = len(alpha) - len(self.names)
        return values, [np.concatenate((dM, np.zeros((rest, *dM.shape[1:])))) for dM in slopes]

    def _step(self, alpha: Array, dt: float) -> tuple[Array, ...]:
        """A, B, Q over one interval with their derivatives."""
        key = (np.asarray(alpha, dtype=float).tobytes(), dt)
        if key not in self._steps:
            if len(self._steps) >= KEPT:
                self._steps.clear()
            self._steps[key] = self._discretised(alpha, dt)
        return self._steps[key]

    def _discretised(self, alpha: Array, dt: float) -> tuple[Array, ...]:
        (F, L, G, *_), (dF, dL, dG, *_) = self._values(alpha)
        if self.model.discretisation == "van_loan":
            W, dW = self._with_noise(alpha, G, dG)
            return discretise(F, L, W, dF, dL, dW, dt)
        A, B, G, dA, dB, dG = _held(self.model, (F, L, G), (dF, dL, dG), dt)
        if self.density:
            G, dG = G / np.sqrt(dt), dG / np.sqrt(dt)
        Q, dQ = self._with_noise(alpha, G, dG)
        return A, B, Q, dA, dB, dQ

    def _with_noise(self, alpha: Array, G: Array, dG: Array) -> tuple[Array, Array]:
        """G Q G' and its derivative in all of alpha."""
        Q, _ = self.noise(alpha)
        half = dG @ Q @ G.T
        dW = half + half.transpose(0, 2, 1)
        for k, i in enumerate(self.process):
            dW[len(self.names) + k] += np.outer(G[:, i], G[:, i])
        return G @ Q @ G.T, dW

    def filter_model(self, alpha: Array, recordings: Sequence[Recording]) -> tuple[CompiledModel, Array] | None:
        """A discrete model with a noise on each state, and the covariance (nx, nx) of that noise.

        It is what a filter with constant matrices needs; None where the tests' intervals differ from each other.
        """
        intervals = np.unique(np.concatenate([r.dt for r in recordings]))
        if len(intervals) > 1:
            return None
        m = self(alpha, recordings[0])
        compiled = linear_model(m.A[0], np.eye(len(m.S_a)), m.C[0], m.B[0], m.D[0])
        return compiled, m.Q[0]


def _held(model: Model, rates: Sequence[Array], slopes: Sequence[Array], dt: float) -> tuple[Array, ...]:
    """A, B, G of a step over which input and noise are held, and their derivatives.

    Raises:
        ModelError: the discretisation has no such matrices.
    """
    (F, L, G), (dF, dL, dG) = rates, slopes
    if model.discretisation == "discrete":
        return F, L, G, dF, dL, dG
    if model.discretisation == "euler":
        return np.eye(len(F)) + dt * F, dt * L, dt * G, dt * dF, dt * dL, dt * dG
    if model.discretisation == "exact":
        none, wide, nu = np.zeros_like(F), np.concatenate((dL, dG), axis=2), L.shape[1]
        A, B, _, dA, dB, _ = discretise(F, np.hstack((L, G)), none, dF, wide, np.zeros_like(dF), dt)
        return A, B[:, :nu], B[:, nu:], dA, dB[:, :, :nu], dB[:, :, nu:]
    raise ModelError(
        f"{model.name}: methods for ensembles of a linear model take the discretisations exact, van_loan, euler and "
        f"discrete, not {model.discretisation}"
    )


def _rates(model: Model, names: Sequence[str]) -> Rates:
    """Compile the coefficients of the equations, and their derivatives, to plain numpy functions.

    Raises:
        ModelError: the model is not linear.
    """
    import sympy as sp

    equations = model.equations()
    f, h = (_without_terms(part, equations.terms) for part in (equations.dynamics, equations.output))
    x, u, v, p = equations.x, equations.u, equations.v, equations.p
    matrices = [_jacobian(f, x), _jacobian(f, u), _jacobian(f, v), _jacobian(h, x), _jacobian(h, u)]
    _check_linear(model, matrices, (f, h), {*x, *u, *v})
    law = model.initial_law()
    matrices.append(sp.zeros(len(x), len(x)) if law is None else law)
    symbols = {str(s): s for s in p}
    slopes = [[M.diff(symbols[name]) for name in names] for M in matrices]
    compiled = sp.lambdify([p], [[list(M) for M in matrices], [[list(d) for d in row] for row in slopes]], cse=True)
    shapes = [M.shape for M in matrices]

    def rates(values: Array) -> tuple[list[Array], list[Array]]:
        found, derivatives = compiled(values)
        return (
            [np.array(M, dtype=float).reshape(shape) for M, shape in zip(found, shapes, strict=True)],
            [np.array(d, dtype=float).reshape(len(names), *s) for d, s in zip(derivatives, shapes, strict=True)],
        )

    return rates


def _without_terms(expressions: Sequence[Any], terms: dict[Any, Any]) -> Any:
    import sympy as sp

    M = sp.Matrix(list(expressions))
    for term, definition in reversed(terms.items()):
        M = M.subs(term, definition)
    return M


def _jacobian(M: Any, vector: Sequence[Any]) -> Any:
    import sympy as sp

    return M.jacobian(list(vector)) if vector else sp.zeros(M.shape[0], 0)


def _check_linear(model: Model, matrices: list[Any], parts: tuple[Any, Any], moving: set[Any]) -> None:
    import sympy as sp

    for M in matrices:
        if sp.simplify(M).free_symbols & moving:
            raise ModelError(f"{model.name} is not linear in its states, inputs and noises; this method needs that.")
    for part in parts:
        rest = sp.simplify(part.subs(dict.fromkeys(moving, 0)))
        if any(value != 0 for value in rest):
            raise ModelError(
                f"{model.name} has a constant term in its equations; this method needs it as an input that is 1."
            )
