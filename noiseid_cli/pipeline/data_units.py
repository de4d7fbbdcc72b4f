"""The datasets of one experiment: what simulates or imports each, and the key of all that it depends on."""

from __future__ import annotations

from noiseid_cli.errors import ConfigError, DataError
from noiseid_cli.pipeline.context import Context
from noiseid_cli.pipeline.keys import digest, unit_path
from noiseid_cli.pipeline.unit import DatasetUnit


def own_dataset_units(context: Context) -> list[DatasetUnit]:
    """The datasets of an experiment without a sweep, or at one point of it.

    Raises:
        ConfigError: recordings that it names cannot be read.
    """
    simulated = context.experiment.simulate is not None
    return _simulated_units(context) if simulated else _imported_units(context)


def _model(context: Context) -> dict[str, str]:
    return {"model": context.loaded.section_key("model"), "equations": context.model_digest}


def _simulated_units(context: Context) -> list[DatasetUnit]:
    section, seed, model = context.experiment.simulate, context.experiment.seed, _model(context)
    assert section is not None
    # The number of replicates is left out: asking for more keeps those that are there.
    settings = section.model_dump(mode="json", exclude={"replicates", "held_out"})
    units = []
    for replicate in range(section.replicates):
        key = digest("simulate", model, settings, {"seed": seed, "replicate": replicate})
        name = f"replicate-{replicate:03d}"
        units.append(DatasetUnit(name, key, unit_path(context, "datasets", name, key), replicate))
    if section.held_out is not None:
        key = digest("simulate", model, settings, section.held_out.model_dump(mode="json"), {"seed": seed})
        units.append(DatasetUnit("held-out", key, unit_path(context, "datasets", "held-out", key), held_out=True))
    return units


def _imported_units(context: Context) -> list[DatasetUnit]:
    section, model = context.experiment.import_, _model(context)
    assert section is not None
    names = tuple(section.recordings)
    separate = section.group == "separate"
    groups = [(name, (name,)) for name in names] if separate else [(context.experiment.experiment, names)]
    common = section.model_dump(mode="json", exclude={"recordings", "group"})
    digests = _recording_digests(context)
    units = []
    for name, members in groups:
        sources = [
            {
                "name": member,
                "settings": section.recordings[member].model_dump(
                    mode="json", exclude={"file": True, "also": {"__all__": {"file"}}}
                ),
                "sha256": digests[member],
            }
            for member in members
        ]
        key = digest("import", model, common, sources)
        units.append(DatasetUnit(name, key, unit_path(context, "datasets", name, key), 0, members))
    return units


def _recording_digests(context: Context) -> dict[str, str]:
    """SHA-256 of each recording: other content makes another dataset, another name or folder does not.

    Raises:
        ConfigError: with every file that cannot be read, and its place in the experiment.
    """
    from noiseid_cli.recordings.readers import source_digest

    section = context.experiment.import_
    assert section is not None
    digests: dict[str, str] = {}
    problems, known = [], context.file_digests
    for name, source in section.recordings.items():
        at = ("import", "recordings", name)
        places = {(*at, "file"): source.file} | {(*at, "also", i, "file"): s.file for i, s in enumerate(source.also)}
        found = []
        for place, file in places.items():
            path = context.loaded.resolve(file)
            try:
                if path not in known:
                    known[path] = source_digest(path)
                found.append(known[path])
            except DataError as error:
                problems.append(context.loaded.problem(place, str(error)))
        digests[name] = "+".join(found)
    if problems:
        raise ConfigError(str(context.loaded.file), problems)
    return digests
