"""What moves a simulated model: the kinds of ``trajectory`` in an experiment, their options and their builders."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from noiseid_cli.errors import ModelError
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.equations import Model
from noiseid_cli.models.known_inputs import with_known_inputs
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Array
from noiseid_cli.simulation import signals
from noiseid_cli.simulation.feedback import StateFeedback
from noiseid_cli.simulation.robot_controller import RobotController, robot_reference
from noiseid_cli.simulation.rollout import Controller
from noiseid_cli.simulation.s_curve import Cascade, SCurve, rests
from noiseid_cli.simulation.trajectory import SquarePath


@dataclass(frozen=True)
class Plan:
    """A motion made ready for one model and a number of samples.

    Attributes:
        controller: sets the inputs.
        x0: (nx,) state that the motion starts from unless another one is asked for.
    """

    controller: Controller
    x0: Array


@dataclass(frozen=True)
class Square:
    """Options of kind ``square``: the tool of the flexible robot runs along a square, over and over.

    Attributes:
        corner: first corner (lower left), m.
        side: length of a side, m, above 0.
        side_time: time for one side, s, above 0.
    """

    corner: tuple[float, float] = (1.2, 0.7)
    side: float = 0.2
    side_time: float = 0.5


@dataclass(frozen=True)
class Zero:
    """Options of kind ``zero``: all inputs are zero."""


@dataclass(frozen=True)
class Multisine:
    """Options of kind ``multisine``: sums of cosines, see ``signals.multisine``.

    Attributes:
        amplitude: largest magnitude of each input, in the input's unit.
        lowest, highest: range of the frequencies, Hz; 0 < lowest <= highest < half the sample rate.
        lines: number of frequencies of each input, at least 1.
    """

    amplitude: tuple[float, ...]
    lowest: float
    highest: float
    lines: int = 10


@dataclass(frozen=True)
class Steps:
    """Options of kind ``steps``: inputs that jump between plus and minus their amplitude, see ``signals.steps``.

    Attributes:
        amplitude: magnitude of each input, in the input's unit.
        hold: shortest time between jumps, s, above 0.
    """

    amplitude: tuple[float, ...]
    hold: float


@dataclass(frozen=True)
class SCurveMotion:
    """Options of kind ``s_curve``: a joint moves to and fro under cascade control, see ``simulation.s_curve``.

    Attributes:
        input: name of the input that drives the joint; the model's other inputs are zero.
        output: name of the output that follows the reference; it must not depend on the input directly.
        between: the two values that the reference moves between, in the output's unit.
        move_time: time of a move, s, above 0.
        dwell: rest after each move, s, from 0.
        position_gain: Kp, 1/s, above 0.
        speed_gain: Kv, in units of the input per unit of the output's rate, above 0.
        cutoff: bandwidth of the filter on the output's difference, Hz, above 0.
        start: first value of the reference; None for the first of the two.
        hold: begin and end of a longer rest, s; None for none.
    """

    input: str
    output: str
    between: tuple[float, float]
    move_time: float
    dwell: float
    position_gain: float
    speed_gain: float
    cutoff: float
    start: float | None = None
    hold: tuple[float, float] | None = None


def _s_curve(options: SCurveMotion, model: Model, compiled: CompiledModel, samples: int) -> Plan:
    for what, name, names in (("input", options.input, compiled.inputs), ("output", options.output, compiled.outputs)):
        known = ", ".join(names) or "none"
        _require(name in names, f"s_curve: {name} is not an {what} of {compiled.name}; it has {known}.")
    positive = (options.move_time, options.position_gain, options.speed_gain, options.cutoff)
    _require(
        min(positive) > 0 and options.dwell >= 0,
        "s_curve: move_time, position_gain, speed_gain and cutoff must be above 0, and dwell at least 0.",
    )
    if options.hold is not None:
        begin, end = options.hold
        standing = 0 < begin < end and rests(begin, options.move_time, options.dwell)
        _require(standing, "s_curve: hold must begin while the reference rests, and end later.")
    start = options.between[0] if options.start is None else options.start
    curve = SCurve(options.between, start, options.move_time, options.dwell, options.hold)
    controller = Cascade(
        curve.at(model.sample_time * np.arange(samples, dtype=np.float64)),
        model.sample_time,
        gains=(options.position_gain, options.speed_gain),
        cutoff=options.cutoff,
        acts_on=compiled.inputs.index(options.input),
        reads=compiled.outputs.index(options.output),
        inputs=compiled.nu,
    )
    return Plan(controller, np.zeros(compiled.nx))


@dataclass(frozen=True)
class Feedback:
    """Options of kind ``state_feedback``: inputs fed back from a filter's state, see ``StateFeedback``.

    Attributes:
        gain: a row for each input, a column for each state.
    """

    gain: tuple[tuple[float, ...], ...]


def _square(options: Square, model: Model, compiled: CompiledModel, samples: int) -> Plan:
    _require(options.side > 0 and options.side_time > 0, "square: side and side_time must be above 0.")
    path = SquarePath(corner=options.corner, side=options.side, side_time=options.side_time)
    dt, lengths = model.sample_time, (model.values["l1"], model.values["l2"])
    reference = robot_reference(compiled, path, samples, dt, *lengths)
    return Plan(RobotController(reference, dt), reference.x0)


def _zero(options: Zero, model: Model, compiled: CompiledModel, samples: int) -> Plan:
    return _open_loop(model, np.zeros((samples, len(model.driven_inputs))))


def _multisine(options: Multisine, model: Model, compiled: CompiledModel, samples: int) -> Plan:
    amplitude = _amplitude("multisine", options.amplitude, model)
    limit = 0.5 / model.sample_time
    _require(
        0 < options.lowest <= options.highest < limit,
        f"multisine: lowest and highest must satisfy 0 < lowest <= highest < {limit:g} Hz (half the sample rate).",
    )
    _require(options.lines >= 1, "multisine: lines must be at least 1.")
    time = model.sample_time * np.arange(samples, dtype=np.float64)
    return _open_loop(model, signals.multisine(time, amplitude, options.lowest, options.highest, options.lines))


def _steps(options: Steps, model: Model, compiled: CompiledModel, samples: int) -> Plan:
    amplitude = _amplitude("steps", options.amplitude, model)
    _require(options.hold > 0, "steps: hold must be above 0 s.")
    return _open_loop(
        model,
        signals.steps(model.sample_time * np.arange(samples, dtype=np.float64), amplitude, options.hold),
    )


def _feedback(options: Feedback, model: Model, compiled: CompiledModel, samples: int, law: NoiseValues) -> Plan:
    rows, columns = len(options.gain), {len(row) for row in options.gain}
    _require(
        rows == compiled.nu and columns == {compiled.nx},
        f"state_feedback: gain must have {compiled.nu} rows (inputs) of {compiled.nx} numbers (states).",
    )
    return Plan(StateFeedback(compiled, model.sample_time, np.array(options.gain), law), law.m0[0])


def _open_loop(model: Model, u: Array) -> Plan:
    everything = with_known_inputs(model, np.ascontiguousarray(u), "the simulation")
    return Plan(signals.Signal(everything), np.zeros(len(model.states)))


def _amplitude(kind: str, amplitude: tuple[float, ...], model: Model) -> Array:
    inputs = model.driven_inputs
    names = ", ".join(q.name for q in inputs) or "none"
    _require(
        len(amplitude) == len(inputs) > 0,
        f"{kind}: amplitude has {len(amplitude)} values; {model.name} has {len(inputs)} inputs: {names}.",
    )
    return np.array(amplitude, dtype=float)


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise ModelError(f"trajectory {message}")


@dataclass(frozen=True)
class Motion:
    """One kind of trajectory.

    Attributes:
        options: dataclass of its options; an option without a default is required.
        build: makes the plan from (options, model, compiled, samples), and the law of all noise where it ``knows_law``.
        models: names of the models that it is for; empty for all.
    """

    options: type
    build: Callable[..., Plan]
    models: tuple[str, ...] = ()
    knows_law: bool = False


MOTIONS = {
    "square": Motion(Square, _square, ("flexible_robot",)),
    "zero": Motion(Zero, _zero),
    "multisine": Motion(Multisine, _multisine),
    "steps": Motion(Steps, _steps),
    "s_curve": Motion(SCurveMotion, _s_curve),
    "state_feedback": Motion(Feedback, _feedback, knows_law=True),
}
"""Each kind that may stand as ``trajectory: {kind: ...}``."""


def plan_motion(
    kind: str, options: Any, model: Model, compiled: CompiledModel, samples: int, law: NoiseValues | None = None
) -> Plan:
    """The motion of one kind for one model.

    Args:
        kind: a key of ``MOTIONS``.
        options: instance of that motion's options.
        model, compiled: the model and its compiled functions.
        samples: number of samples of each test.
        law: true Q and R and the law of the first state; some motions need it.

    Raises:
        ModelError: the kind is not known or not for this model, or an option does not fit the model.
    """
    if kind not in MOTIONS:
        raise ModelError(f"trajectory: kind {kind} is not known; known: {', '.join(MOTIONS)}.")
    motion = MOTIONS[kind]
    if motion.models and model.name not in motion.models:
        others = ", ".join(k for k, m in MOTIONS.items() if not m.models or model.name in m.models)
        raise ModelError(f"trajectory: kind {kind} is not for {model.name}; for this model: {others}.")
    if not motion.knows_law:
        return motion.build(options, model, compiled, samples)
    _require(law is not None, f"{kind}: the law of the noise is needed.")
    return motion.build(options, model, compiled, samples, law)
