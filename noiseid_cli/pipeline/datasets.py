"""The `simulate` and `import` stages: make one dataset file."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING

from noiseid_cli.pipeline.context import Context
from noiseid_cli.pipeline.first_state import simulated
from noiseid_cli.pipeline.unit import DatasetUnit

if TYPE_CHECKING:
    from noiseid_cli.config.schema_import import Column, Companion, Source
    from noiseid_cli.models.equations import Model
    from noiseid_cli.models.recording import Dataset


def make_dataset(context: Context, unit: DatasetUnit) -> Dataset:
    """Simulate or import one dataset and write it.

    Raises:
        NoiseidError: the simulation diverges, or a recording is faulty; nothing is written then.
    """
    from noiseid_cli.storage.dataset_file import write_dataset

    dataset = _import(context, unit) if unit.recordings else _simulate(context, unit)
    write_dataset(unit.path, dataset, file_attributes(context, unit.key))
    return dataset


def file_attributes(context: Context, key: str) -> dict[str, str]:
    """What every file of ours says about its making."""
    from noiseid_cli.storage.provenance import provenance

    return {
        "key": key,
        "config": json.dumps(context.loaded.resolved(), sort_keys=True),
        "model_sha256": context.model_digest,
        "provenance": json.dumps(provenance(), sort_keys=True),
    }


def _simulate(context: Context, unit: DatasetUnit) -> Dataset:
    import numpy as np

    from noiseid_cli.simulation.motions import MOTIONS, plan_motion
    from noiseid_cli.simulation.parameter_changes import ParameterChange
    from noiseid_cli.simulation.simulate import HELD_OUT, STREAM, simulate

    section = context.experiment.simulate
    assert section is not None
    trajectory, tests = section.trajectory, section.tests
    if unit.held_out:
        assert section.held_out is not None
        trajectory, tests = section.held_out.trajectory, section.held_out.tests
    kind = trajectory.kind
    settings = trajectory.model_dump(exclude={"kind"})
    if kind == "s_curve" and settings["hold"] is not None:
        settings["hold"] = (settings["hold"]["begin"], settings["hold"]["end"])
    options = MOTIONS[kind].options(**settings)
    model, true_Q = context.model, section.process_noise.matrix()
    held_Q = true_Q / model.sample_time if section.process_noise.unit == "density" else true_Q
    white = model.discretisation == "van_loan"
    compiled, Q, law = simulated(context, true_Q if white else held_Q, section.measurement_noise.matrix())
    plan = plan_motion(kind, options, model, compiled, section.samples, law)
    dataset = simulate(
        model,
        compiled,
        plan,
        Q,
        section.measurement_noise.matrix(),
        seed=context.experiment.seed,
        samples=section.samples,
        tests=tests,
        replicate=unit.replicate,
        x0=None if section.initial_state is None else law.m0[0],
        P0=law.P0 if np.any(law.P0) else None,
        name=unit.own_name,
        stream=HELD_OUT if unit.held_out else STREAM,
        changes=[ParameterChange(**change.model_dump()) for change in section.parameter_changes],
        first_output=section.first_output,
    )
    return replace(dataset, Q_true=held_Q)


def _import(context: Context, unit: DatasetUnit) -> Dataset:
    from noiseid_cli.diagnostics.data_properties import data_warnings
    from noiseid_cli.models.known_inputs import with_known_inputs
    from noiseid_cli.recordings import import_recordings
    from noiseid_cli.recordings.options import ColumnMap, Decimation, ProblemPolicy, RecordingSource, TimeMap

    section = context.experiment.import_
    assert section is not None
    group = "" if section.format.group is None else f"{section.format.group}/"

    def column_map(column: Column) -> ColumnMap:
        name = f"{group}{column.column}" if group else column.column
        return ColumnMap(name, column.scale, column.offset)

    def source(name: str, own: Source | Companion) -> RecordingSource:
        assert own.time is not None
        time = own.time.model_dump()
        if group and time["column"] is not None:
            time["column"] = f"{group}{time['column']}"
        return RecordingSource(
            name,
            context.loaded.resolve(own.file),
            time=TimeMap(**time),
            outputs={k: column_map(c) for k, c in own.outputs.items()},
            **section.format.model_dump(exclude={"group"}),
        )

    sources = []
    for name in unit.recordings:
        own = section.source(name)
        also = tuple(source(name, other) for other in own.also)
        columns = {k: column_map(c) for k, c in own.inputs.items()}
        sources.append(replace(source(name, own), inputs=columns, rows=own.rows, also=also))
    policy = ProblemPolicy(
        **section.on_problem.model_dump(),
        gap_factor=section.gap_factor,
        interval_tolerance=section.interval_tolerance,
        nominal_interval=section.nominal_interval,
    )
    decimation = None if section.decimate is None else Decimation(**section.decimate.model_dump())
    model = context.model
    inputs, outputs, states = (
        tuple((q.name, q.unit, q.description) for q in group)
        for group in (model.driven_inputs, model.outputs, model.states)
    )
    dataset = import_recordings(unit.own_name, sources, policy, model.name, inputs, outputs, decimation)
    recordings = tuple(replace(r, u=with_known_inputs(model, r.u, f"test {r.name!r}")) for r in dataset.recordings)
    inputs = tuple((q.name, q.unit, q.description) for q in model.inputs)
    direct = [] if decimation is None or decimation.factor == 1 else _direct_notes(model)
    notes = (*dataset.notes, *direct, *data_warnings(dataset))
    return replace(dataset, recordings=recordings, inputs=inputs, states=states, notes=notes)


def _direct_notes(model: Model) -> list[str]:
    """What decimation does to outputs that see an input directly."""
    from noiseid_cli.models.linearity import direct_inputs

    driven = {q.name for q in model.driven_inputs}
    out = []
    for output, seen in zip(model.outputs, direct_inputs(model.equations()), strict=True):
        if names := " and ".join(sorted(seen & driven)):
            out.append(
                f"{output.name} depends directly on {names}, which after decimation is the average over the longer "
                "interval and not the value at the sample: where it moves within an interval, the difference counts as "
                "noise"
            )
    return out
