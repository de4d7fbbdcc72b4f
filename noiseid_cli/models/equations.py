"""The base class of all models: equations written once, in sympy, from which all else is derived."""

from __future__ import annotations

import traceback
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from noiseid_cli.errors import ModelError
from noiseid_cli.models.declarations import (
    Parameter,
    Quantity,
    Symbols,
    Terms,
    check_declarations,
    check_number,
    symbol,
    unknown_name,
)
from noiseid_cli.models.formula import obstacle
from noiseid_cli.models.linearity import nonlinearity
from noiseid_cli.models.recording import Array
from noiseid_cli.models.schemes import SCHEMES

DISCRETISATIONS = tuple(SCHEMES)


@dataclass(frozen=True)
class Equations:
    """A model's equations as checked sympy expressions.

    Attributes:
        x, u, v, p: symbols of the states, inputs, noises and parameters.
        terms: named intermediate quantities and their definitions, each using only those before it.
        dynamics: (nx) dx/dt, or the next state of a discrete model; affine in v.
        output: (ny) h(x, u, p).
        performance: (nz) g(x, u, p).
    """

    x: tuple[Any, ...]
    u: tuple[Any, ...]
    v: tuple[Any, ...]
    p: tuple[Any, ...]
    terms: dict[Any, Any]
    dynamics: tuple[Any, ...]
    output: tuple[Any, ...]
    performance: tuple[Any, ...]


class Model:
    r"""A state-space model: x' = f(x, u, v, p), y = h(x, u, p), and optionally z = g(x, u, p).

    Subclass it, declare the names and write ``dynamics`` and ``output`` with sympy's functions. The noise v
    must enter f linearly (its gain may depend on x, u and p). Every name that is declared as state, input, noise
    or parameter is one symbol, so these names differ from each other; an output may share the name of a state.

    Use ``sympy.tanh`` or ``sympy.Piecewise`` in place of ``sign``, which has no derivative at zero, and
    ``sympy.sech(z)`` in place of ``1/cosh(z)``, whose derivative overflows for large z.

    Attributes:
        name: name of the model, as written in configs and files.
        states, inputs, noises, outputs, performances: names and units of the vectors x, u, v, y and z.
        parameters: names, default values and units of the vector p.
        sample_time: interval between samples in a simulation, s.
        sample_time_parameter: name of the parameter that equals the sample time, for equations that need it, such as
            those of a noise that is added once per sample; empty where there is none.
        discretisation: how f becomes a step: ``euler``, ``rk4``, ``exact`` (f linear in states and noises), or
            ``discrete`` where f is the next state. ``van_loan`` is exact for a linear model driven by white noise: the
            covariance of v is then a spectral density, and only the methods for ensembles take such a model.
        known_inputs: inputs whose values come with the model, (samples,) each; no recording and no trajectory has them.
        citation: the work that the model is from.
        latex_names: LaTeX of names that sympy does not render well, such as ``{"dqa1": r"\dot q_{a1}"}``.
    """

    name: ClassVar[str] = ""
    states: ClassVar[tuple[Quantity, ...]] = ()
    inputs: ClassVar[tuple[Quantity, ...]] = ()
    noises: ClassVar[tuple[Quantity, ...]] = ()
    outputs: ClassVar[tuple[Quantity, ...]] = ()
    performances: ClassVar[tuple[Quantity, ...]] = ()
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    sample_time: ClassVar[float] = 0.0
    sample_time_parameter: ClassVar[str] = ""
    discretisation: ClassVar[str] = ""
    known_inputs: ClassVar[Mapping[str, Array]] = {}
    citation: ClassVar[str] = ""
    latex_names: ClassVar[Mapping[str, str]] = {}

    def __init__(self, parameters: Mapping[str, float] | None = None, /, **overrides: float) -> None:
        """Take the default parameters, with some replaced.

        Args:
            parameters: new values by name.
            overrides: the same as keywords; they win over ``parameters``.

        Raises:
            ModelError: a name is not known, a value is not a finite number, or the class is declared wrongly.
        """
        check_declarations(self)
        if self.discretisation not in DISCRETISATIONS:
            raise ModelError(
                f"{type(self).__name__}: discretisation is {self.discretisation!r}; "
                f"it must be one of {', '.join(DISCRETISATIONS)}."
            )
        self.values = {p.name: float(p.value) for p in self.parameters}
        self.overridden: set[str] = set()
        for name, value in {**(parameters or {}), **overrides}.items():
            if name not in self.values:
                raise ModelError(unknown_name(f"{self.name}: parameter {name}", name, self.values))
            check_number(f"{self.name}: parameter {name}", value)
            self.values[name] = float(value)
            self.overridden.add(name)
        if self.sample_time_parameter in self.overridden:
            self.set_sample_time(self.values[self.sample_time_parameter])

    def set_sample_time(self, seconds: float) -> None:
        """Take another sample time, in the parameter that equals it too.

        Raises:
            ModelError: it is not a finite number above zero.
        """
        check_number(f"{self.name}: sample_time", seconds)
        if seconds <= 0:
            raise ModelError(f"{self.name}: sample_time is {seconds} s; it must be above zero.")
        self.sample_time = float(seconds)  # type: ignore[misc]  # the class states its own; an instance may differ
        if self.sample_time_parameter:
            self.values[self.sample_time_parameter] = self.sample_time
            if self.sample_time != type(self).sample_time:
                self.overridden.add(self.sample_time_parameter)

    def dynamics(self, x: Any, u: Any, v: Any, p: Any) -> Any:
        """Right-hand sides f, one expression per state."""
        raise ModelError(f"{type(self).__name__}: write the method dynamics(self, x, u, v, p).")

    def output(self, x: Any, u: Any, p: Any) -> Any:
        """Measured outputs h, one expression per output."""
        raise ModelError(f"{type(self).__name__}: write the method output(self, x, u, p).")

    def performance(self, x: Any, u: Any, p: Any) -> Any:
        """Quantities of interest g that are not measured, such as a tool position."""
        return []

    def initial_covariance(self, p: Any) -> Any:
        """Covariance of the part of the first state that the model itself gives, such as a stationary process.

        (nx, nx) as a sympy matrix or nested lists of parameters, zero for states that it says nothing of; None for no
        such part. The methods for ensembles read it: the law of the other states is theirs to estimate.
        """
        return None

    def terms(self, x: Any, u: Any, p: Any) -> Terms:
        """Named intermediate quantities that ``dynamics``, ``output`` and ``performance`` may use."""
        return Terms()

    @property
    def driven_inputs(self) -> tuple[Quantity, ...]:
        """The inputs that a recording or a trajectory gives: those that do not come with the model."""
        return tuple(q for q in self.inputs if q.name not in self.known_inputs)

    @property
    def vector(self) -> Array:
        """(np,) parameter values, in the order of declaration."""
        return np.array(list(self.values.values()), dtype=float)

    @property
    def parameters_in_force(self) -> tuple[Parameter, ...]:
        """The parameters with the values of this instance; those given to it have the source ``given``."""
        return tuple(
            replace(p, value=self.values[p.name], source="given") if p.name in self.overridden else p
            for p in self.parameters
        )

    def equations(self) -> Equations:
        """Build and check the equations.

        Raises:
            ModelError: the methods fail, or their expressions do not fit the declared names.
        """
        x = Symbols("x", [q.name for q in self.states])
        u = Symbols("u", [q.name for q in self.inputs])
        v = Symbols("v", [q.name for q in self.noises])
        p = Symbols("p", [q.name for q in self.parameters])
        definitions = self._definitions(x, u, v, p)
        known = {*x, *u, *p, *definitions}
        equations = Equations(
            x=tuple(x),
            u=tuple(u),
            v=tuple(v),
            p=tuple(p),
            terms=definitions,
            dynamics=self._expressions("dynamics", (x, u, v, p), self.states, {*known, *v}),
            output=self._expressions("output", (x, u, p), self.outputs, known),
            performance=self._expressions("performance", (x, u, p), self.performances, known),
        )
        self._check_noise(equations)
        if self.discretisation in ("exact", "van_loan") and (why := nonlinearity(equations)):
            raise ModelError(
                f"{self.name}: discretisation {self.discretisation} is for linear dynamics only; {why}. Take rk4."
            )
        return equations

    def initial_law(self) -> Any | None:
        """``initial_covariance`` as a checked (nx, nx) sympy matrix; None where the model gives none.

        Raises:
            ModelError: it is not a symmetric matrix of that size, or uses other symbols than parameters.
        """
        p = Symbols("p", [q.name for q in self.parameters])
        given = self._call("initial_covariance", p)
        if given is None:
            return None
        import sympy as sp

        where, n = f"{type(self).__name__}.initial_covariance", len(self.states)
        try:
            law = sp.Matrix(given)
        except (TypeError, ValueError) as error:
            raise ModelError(f"{where} must return a matrix, not {given!r}: {error}.") from None
        if law.shape != (n, n) or law != law.T:
            raise ModelError(f"{where} must be a symmetric {n} by {n} matrix, not {law.shape[0]} by {law.shape[1]}.")
        for value in law:
            self._expression("initial_covariance", "an entry", value, set(p))
        return law

    @property
    def free_first_states(self) -> tuple[Quantity, ...]:
        """The states whose first value has a law that the model does not give: all, or all but those of that law."""
        law = self.initial_law()
        return tuple(q for i, q in enumerate(self.states) if law is None or law[i, i] == 0)

    def _definitions(self, x: Symbols, u: Symbols, v: Symbols, p: Symbols) -> dict[Any, Any]:
        terms = self._call("terms", x, u, p)
        if not isinstance(terms, Terms):
            raise ModelError(f"{type(self).__name__}.terms must return a Terms object, not {terms!r}.")
        definitions: dict[Any, Any] = {}
        for name, value in terms.definitions().items():
            if symbol(name) in {*x, *u, *v, *p}:
                raise ModelError(f"{type(self).__name__}.terms: {name} is declared as a quantity too; rename it.")
            known = {*x, *u, *p, *definitions}
            definitions[symbol(name)] = self._expression("terms", name, value, known)
        return definitions

    def _call(self, method: str, *vectors: Any) -> Any:
        try:
            return getattr(self, method)(*vectors)
        except (Exception, SystemExit) as error:
            place = traceback.extract_tb(error.__traceback__)[1:]
            lines = [f.lineno for f in place if f.name == method]
            line = f", line {lines[-1]}" if lines else ""
            text = str(error)
            if not isinstance(error, ModelError):
                text = f"{type(error).__name__}: {text} (equations use sympy's functions, such as sympy.sin)"
            raise ModelError(f"{type(self).__name__}.{method}{line}: {text}") from error

    def _expressions(
        self, method: str, vectors: tuple[Any, ...], names: tuple[Quantity, ...], known: set[Any]
    ) -> tuple[Any, ...]:
        values = self._call(method, *vectors)
        if isinstance(values, str) or not hasattr(values, "__len__") or not hasattr(values, "__iter__"):
            raise ModelError(f"{type(self).__name__}.{method} must return a list of formulas, not {_shown(values)}.")
        if len(values) != len(names):
            raise ModelError(
                f"{type(self).__name__}.{method} returns {len(values)} expressions for {len(names)} names: "
                f"{', '.join(q.name for q in names) or 'none'}."
            )
        pairs = zip(names, values, strict=True)
        return tuple(self._expression(method, q.name, value, known) for q, value in pairs)

    def _expression(self, method: str, name: str, value: Any, known: set[Any]) -> Any:
        import sympy as sp

        where = f"{type(self).__name__}.{method}: the expression of {name}"
        try:
            expression = sp.sympify(value, strict=True)
        except sp.SympifyError:
            raise ModelError(f"{where} is {_shown(value)}, which is not a sympy expression.") from None
        if not isinstance(expression, sp.Expr):
            raise ModelError(f"{where} is {_shown(value)}, which is not a single number or formula.")
        if expression.has(sp.nan, sp.zoo, sp.oo, -sp.oo, sp.I):
            raise ModelError(f"{where} is {expression}, not a finite real number: is there a division by 0?")
        if cannot := obstacle(expression):
            raise ModelError(f"{where} holds {cannot}.")
        strangers = sorted(str(s) for s in expression.free_symbols - known)
        if strangers:
            raise ModelError(
                f"{where} uses symbols that are not declared or not allowed there: {', '.join(strangers)}. "
                "Take states from x, inputs from u, parameters from p and, in dynamics only, noises from v; "
                "do not make symbols."
            )
        return expression

    def _check_noise(self, equations: Equations) -> None:
        import sympy as sp

        v = set(equations.v)
        drives = dict.fromkeys(equations.v, False)
        for state, f in zip(self.states, equations.dynamics, strict=True):
            for noise in v & f.free_symbols:
                gain = sp.diff(f, noise)
                if gain.free_symbols & v:
                    gain = sp.simplify(gain)
                if gain.free_symbols & v:
                    raise ModelError(
                        f"{type(self).__name__}.dynamics: the noise {noise} enters the equation of {state.name} "
                        "nonlinearly; it must enter as gain * noise, where the gain may depend on x, u, p."
                    )
                drives[noise] |= gain != 0
        idle = [str(noise) for noise, used in drives.items() if not used]
        if idle:
            raise ModelError(
                f"{type(self).__name__}.dynamics: the noise {', '.join(idle)} drives no state; use it or leave it out."
            )


def _shown(value: object) -> str:
    """What stands in the place of a formula, in one line: a matrix takes several."""
    return " ".join(repr(value).split())[:200]
