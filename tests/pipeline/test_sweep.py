"""A sweep is many experiments: what each point makes does not depend on the others, on the order or on the workers."""

import csv

import pytest
from small_experiment import CONFIG, arrays_of, noiseid, write_experiment

from noiseid_cli.errors import ConfigError
from noiseid_cli.pipeline.context import open_experiment
from noiseid_cli.pipeline.reporting import gather
from noiseid_cli.pipeline.units import dataset_units, estimate_units
from noiseid_cli.report.summary import terminal_tables

SWEPT = CONFIG + "sweep:\n  axes:\n    noise: {vary: simulate.process_noise.std.0, values: VALUES}\n"


def swept(folder, values="[0.2, 0.5]", more=""):
    return write_experiment(folder, SWEPT.replace("VALUES", values) + more)


def names(folder):
    return sorted(path.name for path in (folder / "small").rglob("*.h5"))


def test_points_have_names_and_files_of_their_own(tmp_path):
    context = open_experiment(swept(tmp_path), tmp_path)
    assert [unit.name for unit in dataset_units(context)] == ["point-000/replicate-000", "point-001/replicate-000"]
    units = estimate_units(context)
    assert [unit.name for unit in units][1:3] == [
        "point-000/replicate-000/em/start-1",
        "point-001/replicate-000/em/start-0",
    ]
    assert len({unit.path for unit in units}) == 4


def test_a_value_that_only_the_estimate_reads_shares_the_dataset(tmp_path):
    more = "    start: {vary: estimate.process_noise.start.std.0, values: [1, 2]}\n"
    context = open_experiment(swept(tmp_path, more=more), tmp_path)
    assert len(dataset_units(context)) == 2
    assert len({unit.path for unit in estimate_units(context)}) == 8


def test_the_same_bits_with_one_process_and_with_two_and_after_more_values(tmp_path):
    file = swept(tmp_path)
    assert noiseid("run", file, "-q", "-o", tmp_path / "one").exit_code == 0
    assert noiseid("run", file, "-q", "-o", tmp_path / "two", "--jobs", "2").exit_code == 0
    made = names(tmp_path / "one")
    assert len(made) == 6
    assert names(tmp_path / "two") == made
    swept(tmp_path, "[1.0, 0.5, 0.2]")  # other numbers, and one more
    assert noiseid("run", file, "-o", tmp_path / "two").exit_code == 0
    assert set(made) < set(names(tmp_path / "two"))
    assert noiseid("run", file, "-q", "-o", tmp_path / "three", "--jobs", "2").exit_code == 0
    assert names(tmp_path / "three") == names(tmp_path / "two")
    for path in (tmp_path / "three/small").rglob("*.h5"):
        others = [p for folder in ("one", "two") for p in (tmp_path / folder).rglob(path.name)]
        assert others
        assert all(arrays_of(p) == arrays_of(path) for p in others)


def test_a_point_is_the_experiment_with_its_value(tmp_path):
    file = swept(tmp_path, "[0.2]")
    noiseid("run", file, "-q", "-o", tmp_path / "swept")
    noiseid(
        "run", write_experiment(tmp_path), "-q", "-o", tmp_path / "plain", "--set", "simulate.process_noise.std.0=0.2"
    )
    found, plain = (sorted((tmp_path / f).rglob("results/*.h5")) for f in ("swept", "plain"))
    assert len(found) == len(plain) == 2
    for a, b in zip(found, plain, strict=True):
        assert arrays_of(a) == arrays_of(b)


def test_results_gather_into_one_tidy_table_with_a_column_for_each_axis(tmp_path):
    file = swept(tmp_path, more="    start: {vary: estimate.process_noise.start, values: [{std: [1]}, {std: [2]}]}\n")
    assert noiseid("run", file, "-q", "-o", tmp_path).exit_code == 0
    with (tmp_path / "small/report/results.csv").open() as table:
        rows = [row for row in csv.DictReader(table) if (row["metric"], row["at"]) == ("process_noise_std", "truth")]
    assert {(row["sweep_noise"], row["value"]) for row in rows} == {("0.2", "0.2"), ("0.5", "0.5")}
    assert {row["sweep_start"] for row in rows} == {'{"std": [1]}', '{"std": [2]}'}
    study, _ = gather(open_experiment(file, tmp_path))
    _, table = terminal_tables(study)
    assert [row[:3] for row in table.rows] == [
        ("em", noise, start) for noise in (0.2, 0.5) for start in ('{"std": [1]}', '{"std": [2]}')
    ]
    assert all(row[5] == "2 / 2" for row in table.rows)
    for row in table.rows:
        assert row[8] == pytest.approx(row[6] / row[1], rel=1e-12)
    page = (tmp_path / "small/report/report.md").read_text()
    assert "What do the varied settings change?" in page
    assert "noise: simulate.process" in page


def test_every_point_is_checked_before_anything_is_done(tmp_path):
    file = swept(tmp_path, "[0.2, -1]")
    with pytest.raises(ConfigError, match=r"20:.*at point-001: noise = -1"):
        open_experiment(file, tmp_path)
    # Not a fault of the schema, but of the model: it has one noise, not two.
    axis = "{vary: simulate.process_noise, values: [{std: [1, 2]}, {std: [1]}]}"
    file.write_text(CONFIG + f"sweep:\n  axes:\n    q: {axis}\n")
    with pytest.raises(ConfigError) as error:
        open_experiment(file, tmp_path)
    assert [p.message.endswith("(at point-000: q = {'std': [1, 2]})") for p in error.value.problems] == [True]
