"""Keys of units: what they depend on, and what they must not depend on."""

import pytest
from small_experiment import CONFIG, MEASURED, write_recordings

from noiseid_cli.errors import ConfigError, DataError, EstimationError
from noiseid_cli.pipeline.context import open_experiment
from noiseid_cli.pipeline.starts import starts
from noiseid_cli.pipeline.units import chosen_methods, dataset_units, estimate_units, waiting_units


def opened(file, *overrides, seed=None):
    return open_experiment(file, file.parent / "runs", overrides, seed)


def keys(file, *overrides, seed=None):
    """Keys of datasets and of results, by name."""
    context = opened(file, *overrides, seed=seed)
    return {u.name: u.key for u in dataset_units(context)}, {u.name: u.key for u in estimate_units(context)}


def test_names_and_files(small):
    context = opened(small)
    (data,) = dataset_units(context)
    units = estimate_units(context)
    assert data.path == small.parent / f"runs/small/datasets/replicate-000-{data.key[:8]}.h5"
    assert [u.name for u in units] == ["replicate-000/em/start-0", "replicate-000/em/start-1"]
    assert units[1].path == small.parent / f"runs/small/results/replicate-000.em.start-1-{units[1].key[:8]}.h5"
    assert [len(u.key) for u in (data, *units)] == [64] * 3
    assert not any(u.done for u in (data, *units))
    assert [u.needs for u in units] == [(data,)] * 2


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("seed: 7", "# a comment\nseed: 7.0  # the same"),
        ("samples: 80", "tests: 1\n  samples: 8e1"),
        ("experiment: small\nseed: 7", "seed: 7\nexperiment: small"),
        ("report: {formats: [csv, md]}", "report: {title: Other}"),
        ("experiment: small", "experiment: other"),
        ("em: {}", "em: {max_passes: 500}"),
    ],
)
def test_what_means_the_same_keeps_the_keys(small, old, new):
    before = keys(small)
    small.write_text(CONFIG.replace(old, new))
    assert keys(small) == before


def test_more_replicates_methods_and_starts_keep_what_is_there(small):
    before = keys(small)
    more = CONFIG.replace("samples: 80", "samples: 80\n  replicates: 3").replace("[0.1, 10]", "[0.1, 10, 100]")
    small.write_text(more.replace("em: {}", "em: {}\n    other: {method: em, max_passes: 9}"))
    datasets, results = keys(small)
    assert len(datasets) == 3
    assert len(results) == 3 * 2 * 3
    assert before[0].items() < datasets.items()
    assert before[1].items() < results.items()
    assert len(set(results.values())) == len(results)
    # An option of one method is no affair of another.
    again = keys(small, "estimate.methods.other.max_passes=10")[1]
    assert {n for n in results if results[n] != again[n]} == {n for n in results if "/other/" in n}


@pytest.mark.parametrize(
    "override",
    [
        "simulate.samples=81",
        "simulate.tests=2",
        "simulate.sample_time=0.02",
        "simulate.process_noise.std=[0.6]",
        "simulate.initial_state=[0, 1]",
        "simulate.trajectory.lines=2",
        "model.parameters.k=41",
        "model.discretisation=euler",
        "seed=8",
    ],
)
def test_what_changes_the_data_changes_all_keys(small, override):
    (data, results), (other_data, other_results) = keys(small), keys(small, override)
    assert not set(data.values()) & set(other_data.values())
    assert not set(results.values()) & set(other_results.values())


@pytest.mark.parametrize(
    "override",
    [
        "estimate.process_noise.start.std=[2]",
        "estimate.process_noise.structure=diagonal",
        "estimate.measurement_noise.known.std=[2e-3]",
        "estimate.initial_mean.known=[0, 0]",
        "estimate.initial_covariance.known.std=[1, 1]",
        "estimate.methods.em.max_passes=9",
        "estimate.methods.em.stop=loglik",
        "estimate.measurement_noise={start: {std: [1e-3]}}",
    ],
)
def test_what_changes_the_estimate_leaves_the_data_alone(small, override):
    (data, results), (same_data, other_results) = keys(small), keys(small, override)
    assert data == same_data
    assert not set(results.values()) & set(other_results.values())


def test_the_seed_flag_is_the_setting(small):
    assert keys(small, seed=8) == keys(small, "seed=8") != keys(small)


def test_the_equations_of_a_model_file_count_and_its_text_does_not(small):
    before = keys(small)
    model = small.parent / "cart.py"
    text = model.read_text()
    model.write_text(
        text.replace('"""Cart on a spring', '"""A cart on a spring').replace("class Cart", "\n\nclass Cart")
    )
    assert keys(small) == before
    model.write_text(text.replace("p.d * x.w", "p.d * x.w**3"))
    changed = keys(small)
    model.write_text(text.replace('Parameter("k", 40.0', 'Parameter("k", 50.0'))
    parameter = keys(small)
    for kind in (0, 1):
        values = [*before[kind].values(), *changed[kind].values(), *parameter[kind].values()]
        assert len(set(values)) == len(values)


def test_the_content_of_a_recording_counts_and_its_place_does_not(small):
    small.write_text(MEASURED)
    folder = small.parent
    write_recordings(folder)
    before = keys(small)
    (folder / "elsewhere").mkdir()
    (folder / "good.csv").rename(folder / "elsewhere/log.csv")
    small.write_text(MEASURED.replace("good.csv", "elsewhere/log.csv"))
    assert keys(small) == before
    log = folder / "elsewhere/log.csv"
    log.write_text(log.read_text() + "0.80,0,0\n")
    after = keys(small)
    for kind, count in ((0, 1), (1, 2)):
        assert len({n for n in before[kind] if before[kind][n] != after[kind][n]}) == count
    # The recordings as the tests of one dataset: all of them count, under the experiment's name.
    together = keys(small, "import.group=together")
    assert list(together[0]) == ["small"]
    for override in ("import.on_problem.gap=split", "import.recordings.bad.rows=[1, 9]", "import.gap_factor=4"):
        assert keys(small, "import.group=together", override)[0] != together[0]
    assert keys(small, seed=99) == after  # nothing is random here


def test_recordings_that_are_not_there_are_all_named(small):
    small.write_text(MEASURED)
    with pytest.raises(ConfigError) as refused:
        dataset_units(opened(small))
    assert [(p.path, p.line) for p in refused.value.problems] == [
        ("import.recordings.good.file", 6),
        ("import.recordings.bad.file", 7),
    ]


def test_held_out_tests_are_a_dataset_that_no_method_runs_on(small):
    held_out = "simulate.held_out={tests: 2, trajectory: {kind: zero}}"
    before, (data, results) = keys(small), keys(small, held_out)
    assert data.keys() == {"replicate-000", "held-out"}
    assert data["replicate-000"] == before[0]["replicate-000"]
    assert results.keys() == before[1].keys()
    assert not set(results.values()) & set(before[1].values())
    units = estimate_units(opened(small, held_out))
    assert {d.name for unit in units for d in unit.needs} == {"replicate-000", "held-out"}


def test_given_starts_scale_process_and_measurement_noise(small):
    unknown = "estimate.measurement_noise={start: {std: [1e-3]}}"
    given = starts(opened(small, unknown, "estimate.starts.measurement_scale=[2, 3]"))
    assert [(s.index, s.factors, s.measurement_factor) for s in given] == [(0, (0.1,), 2.0), (1, (10.0,), 3.0)]
    before = keys(small, unknown)
    after = keys(small, unknown, "estimate.starts.measurement_scale=[1, 2]")
    assert [before[1][name] == after[1][name] for name in before[1]] == [True, False]


def test_methods_are_found_by_label_then_by_name(small):
    context = opened(small, "estimate.methods={a: {method: em, max_passes: 5}, alg3: {method: em}}")
    assert list(chosen_methods(context)) == ["a", "alg3"]
    assert chosen_methods(context, ["alg3"])["alg3"].method == "em"  # a label goes before a method of that name
    assert list(chosen_methods(context, ["em"])) == ["a", "alg3"]
    with pytest.raises(EstimationError, match=r"alg2 takes .*diagonal"):  # its start is full here
        chosen_methods(context, ["alg2"])
    context = opened(small, "estimate.methods={a: {method: em}}", "estimate.process_noise.structure=diagonal")
    assert chosen_methods(context, ["alg2"])["alg2"].method == "alg2"
    context = opened(small, "estimate.methods={a: {method: em, max_passes: 5}, alg3: {method: em}}")
    with pytest.raises(EstimationError, match=r"'emm' is not a method; known: a, alg3, em, .*did you mean em\?"):
        chosen_methods(context, ["emm"])


def test_units_wait_for_their_datasets(small):
    context = opened(small, "simulate.replicates=2")
    units = estimate_units(context)
    with pytest.raises(DataError, match="run `noiseid simulate` first"):
        waiting_units(context, units)
    path = units[0].dataset.path
    path.parent.mkdir(parents=True)
    path.write_bytes(b"")
    assert waiting_units(context, units) == units[2:]
    for unit in units[2:]:
        unit.path.parent.mkdir(exist_ok=True)
        unit.path.write_bytes(b"")
    assert waiting_units(context, units) == []
    assert waiting_units(context, units, force=True) == units[2:]
