"""Start values for a starter experiment, taken from the log, each with the reason for it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from noiseid_cli.models.equations import Model
from noiseid_cli.pipeline.starter import Plan
from noiseid_cli.recordings.survey import ColumnFacts
from noiseid_cli.recordings.table import Key

_LAG = 10  # samples over which a slope or a bend is taken: long enough to stand out of the noise


class Value(NamedTuple):
    """A number, and why it is that."""

    number: float
    why: str


def measurement_stds(plan: Plan) -> list[Value]:
    """Start of the standard deviation of each output's noise."""
    return [_measurement_std(plan.found.column(key)) for key in plan.outputs.values()]


def _measurement_std(column: ColumnFacts) -> Value:
    if column.noise > column.rounding:
        return Value(column.noise, f"scatter of {column.key} from row to row")
    if column.step:
        why = f"{column.key} comes in steps of {column.step:.3g}, which is {column.rounding:.3g} rms of rounding"
        return Value(column.rounding, why)
    spread = 1e-3 * float(np.std(column.known)) or 1.0
    return Value(spread, f"chosen: {column.key} shows no noise; a thousandth of its spread")


def process_stds(plan: Plan) -> list[Value]:
    """Start of the standard deviation of each process noise."""
    if plan.model is None:
        return [
            Value(_bend(plan, plan.found.column(key)) or 1.0, f"how strongly {key} accelerates in this log")
            for key in plan.outputs.values()
        ]
    return [_model_noise(plan, plan.model, number) for number in range(len(plan.model.noises))]


def _model_noise(plan: Plan, model: Model, number: int) -> Value:
    """A tenth of the input that has the noise's unit; 1 where there is none."""
    unit, count = model.noises[number].unit, len(model.noises)
    kin = [q.name for q in model.inputs if q.unit == unit]
    if kin:
        name = kin[number] if len(kin) == count else kin[0]
        size = 0.1 * float(np.std(plan.found.column(plan.inputs[name]).known))
        if size > 0.0:
            return Value(size, f"chosen: a tenth of the spread of {plan.inputs[name]}, which has the same unit")
    return Value(1.0, f"chosen: the log does not tell; in {unit or 'no unit'} per sample")


def first_state(plan: Plan) -> tuple[list[Value], list[Value]]:
    """Mean and standard deviation of each state at the first sample."""
    measured = dict(zip(plan.outputs.values(), measurement_stds(plan), strict=True))
    mean, std = [], []
    for state, key, is_speed in _states(plan):
        if key is None:
            mean.append(Value(0.0, f"{state}: chosen, no output shows it directly"))
            std.append(Value(1.0, f"{state}: chosen"))
            continue
        column = plan.found.column(key)
        if is_speed:
            mean.append(Value(0.0, f"{state}: taken to begin at rest"))
            size = _slope(plan, column) or measured[key].number / plan.time.interval
            std.append(Value(size, f"{state}: spread of the speed of {key} over the log"))
        else:
            mean.append(Value(float(np.median(column.known[:5])), f"{state}: where {key} begins"))
            std.append(Value(3.0 * measured[key].number, f"{state}: three times the noise of {key}"))
    return mean, std


def _states(plan: Plan) -> list[tuple[str, Key | None, bool]]:
    """Each state with the column that shows it, and whether it is the speed of what the column shows."""
    if plan.model is None:
        return [(f"{name}{end}", key, bool(end)) for name, key in plan.outputs.items() for end in ("", "_speed")]
    equations = plan.model.equations()
    shown = {h: key for h, key in zip(equations.output, plan.outputs.values(), strict=True) if h in equations.x}
    continuous = plan.model.discretisation != "discrete"
    speeds = {f: shown[x] for x, f in zip(equations.x, equations.dynamics, strict=True) if continuous and x in shown}
    return [(str(x), shown.get(x, speeds.get(x)), x not in shown and x in speeds) for x in equations.x]


def _slope(plan: Plan, column: ColumnFacts) -> float:
    lag = _lag(column)
    return float(np.std(column.known[lag:] - column.known[:-lag])) / (lag * plan.time.interval)


def _bend(plan: Plan, column: ColumnFacts) -> float:
    lag, values = _lag(column), column.known
    if len(values) < 2 * lag + 1:
        return 0.0
    bends = values[2 * lag :] - 2.0 * values[lag:-lag] + values[: -2 * lag]
    return float(np.std(bends)) / (lag * plan.time.interval) ** 2


def _lag(column: ColumnFacts) -> int:
    return max(1, min(_LAG, len(column.known) // 4))
