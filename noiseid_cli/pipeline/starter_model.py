"""The text of a starter model: each output is a position that inputs and noise accelerate."""

from __future__ import annotations

import json

from noiseid_cli.pipeline.starter import MODEL_CLASS, MODEL_FILE, Plan, unit_of

_HEAD = '''\
"""A model to begin with, written by `noiseid init`. Put your own equations in its place."""

from noiseid_cli.models import {imported}


class {model_class}(Model):
    """Each output is a position; the inputs and a random acceleration drive its speed.

    It knows no physics: its noise stands in for all that it leaves out. Replace `dynamics` by the equations of your
    system, with sympy's functions where you need them (`from sympy import sin`), and declare what they use.
    `noiseid models show {file}:{model_class}` prints the equations; Jacobians and compiled code follow from them.
    """

    name = "{name}"
'''


def model_text(plan: Plan) -> str:
    """Python source of the model, commented."""
    outputs, gains = list(plan.outputs), _gains(plan)
    units = {name: unit_of(key) for name, key in [*plan.inputs.items(), *plan.outputs.items()]}

    def per(name: str, power: str) -> str:
        return f"{units[name]}/s{power}" if units[name] else ""

    states = [
        line
        for name in outputs
        for line in (
            _quantity(name, units[name], f"what {plan.outputs[name]} measures"),
            _quantity(f"{name}_speed", per(name, ""), "its rate of change"),
        )
    ]
    inputs = [_quantity(name, units[name], f"column {key}") for name, key in plan.inputs.items()]
    noises = [_quantity(f"v_{name}", per(name, "^2"), f"random acceleration of {name}, per sample") for name in outputs]
    measured = [_quantity(name, units[name], f"column {key}") for name, key in plan.outputs.items()]
    parameters = [
        f'Parameter("{gain}", 1.0, "", "acceleration of {output} per unit of {given}", source="chosen")'
        for gain, output, given in gains
    ]
    text = _HEAD.format(
        model_class=MODEL_CLASS,
        file=MODEL_FILE,
        name="starter_model",
        imported="Model, Parameter, Quantity" if gains else "Model, Quantity",
    )
    text += "    # Name, unit, description. Fill in the units: reports and exports repeat them.\n"
    for group, lines in (
        ("states", states), ("inputs", inputs), ("noises", noises), ("outputs", measured), ("parameters", parameters),
    ):  # fmt: skip
        text += _tuple(group, lines)
    text += f'    discretisation = "rk4"\n    sample_time = {plan.time.interval:.6g}  # s, used by simulations\n'
    text += "\n    def dynamics(self, x, u, v, p):\n        # One line a state: its derivative.\n        return [\n"
    for name in outputs:
        force = " + ".join(
            [*(f"p.{gain} * u.{given}" for gain, output, given in gains if output == name), f"v.v_{name}"]
        )
        text += f"            x.{name}_speed,\n            {force},\n"
    text += "        ]\n\n    def output(self, x, u, p):\n        # One entry an output: what its sensor shows.\n"
    return text + f"        return [{', '.join(f'x.{name}' for name in outputs)}]\n"


def _gains(plan: Plan) -> list[tuple[str, str, str]]:
    """Parameter, output and input of each gain: in pairs where there are as many of both, else all on all."""
    inputs, outputs = list(plan.inputs), list(plan.outputs)
    pairs = zip(outputs, inputs, strict=True) if len(inputs) == len(outputs) else (
        (output, given) for output in outputs for given in inputs
    )  # fmt: skip
    return [(f"gain_{output}_{given}", output, given) for output, given in pairs]


def _quantity(name: str, unit: str, description: str) -> str:
    return f"Quantity({_text(name)}, {_text(unit)}, {_text(description)})"


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False)


def _tuple(name: str, lines: list[str]) -> str:
    if not lines:
        return f"    {name} = ()\n"
    return f"    {name} = (\n" + "".join(f"        {line},\n" for line in lines) + "    )\n"
