"""The stages as a user runs them: what is made, what is left alone, what is said where."""

import json
import subprocess

import pytest
from small_experiment import COMMAND, CONFIG, MEASURED, arrays_of, files_of, noiseid, write_experiment, write_recordings

from noiseid_cli.config.load import load_experiment
from noiseid_cli.storage.atomic import _machine
from noiseid_cli.storage.result_file import read_result, read_result_attributes


def results(folder):
    return sorted((folder / "runs/small/results").glob("*.h5"))


def test_bare_simulate_and_estimate_in_an_empty_folder(empty):
    short = ("--set", "simulate.samples=200")
    made = noiseid("simulate", *short)
    assert made.exit_code == 0, made.stderr
    assert "the built-in flexible_robot, since none was named" in made.stderr
    assert made.stdout.startswith("simulate: 1 dataset made now:\n  runs/flexible_robot/datasets/replicate-000-")
    found = noiseid("estimate", "--method", "em", *short)
    assert found.exit_code == 0, found.stderr
    assert "Standard deviations of the process noise" in found.stdout
    assert "estimate: 2 results made now:\n  runs/flexible_robot/results/replicate-000.em.start-0-" in found.stdout


def test_estimate_without_datasets_says_what_makes_them(small):
    result = noiseid("estimate")
    assert result.exit_code == 3
    assert result.stderr.splitlines()[-1] == (
        "noiseid: runs/small/datasets lacks datasets of these settings: run `noiseid simulate` first, or "
        "`noiseid run` for all stages"
    )
    assert noiseid("simulate", "--seed", "8").exit_code == 0
    assert "(1 of other settings: give each command the same --set and --seed)" in noiseid("estimate").stderr


def test_the_second_run_touches_no_file(small):
    assert noiseid("run").exit_code == 0
    before = files_of(small)
    assert "runs/small/report/report.md" in before
    again = noiseid("run")
    assert again.exit_code == 0
    assert again.stderr.splitlines()[1:] == [
        "simulate: 1 unit, all there already",
        "estimate: 2 units, all there already",
    ]
    assert "report: runs/small/report/report.md" in again.stdout
    assert noiseid("simulate").stdout.startswith("simulate: nothing to do, 1 dataset there:\n  runs/small/datasets/")
    assert "estimate: nothing to do, 2 results there:" in noiseid("estimate").stdout
    assert files_of(small) == before


def test_force_does_it_again_with_the_same_numbers(small):
    noiseid("run")
    before, numbers = files_of(small / "runs"), [arrays_of(p) for p in results(small)]
    assert noiseid("run", "--force", "-q").exit_code == 0
    after = files_of(small / "runs")
    assert after.keys() == before.keys()
    assert all(after[name] > before[name] for name in after if name.endswith(".h5"))
    assert [arrays_of(p) for p in results(small)] == numbers


def test_a_changed_setting_makes_new_files_and_keeps_the_old(small):
    noiseid("run")
    before = files_of(small / "runs/small/results") | files_of(small / "runs/small/datasets")
    assert noiseid("run", "--seed", "8", "--set", "estimate.starts.scale=[1]").exit_code == 0
    after = files_of(small / "runs/small/results") | files_of(small / "runs/small/datasets")
    assert before.items() < after.items()
    assert len(after) == len(before) + 2


def test_the_settings_kept_with_a_result_are_those_that_ran(small):
    noiseid("run", "--set", "estimate.methods.em.max_passes=50", "--seed", "9")
    loaded = load_experiment(small / "noiseid.yaml", ["estimate.methods.em.max_passes=50"], 9)
    for path in results(small):
        attributes = read_result_attributes(path)
        assert json.loads(attributes["config"]) == loaded.resolved()
        result = read_result(path)
        assert result.seed == 9
        # The weights of sigma points are no settings of the extended smoother.
        idle = {"method", "structure", "alpha", "beta", "kappa"}
        settings = loaded.experiment.estimate.methods["em"].model_dump(exclude=idle)
        assert result.estimate.settings == {"structure": "full", **settings}
        assert result.estimate.start.Q[0, 0] == pytest.approx({0: 0.1, 1: 10.0}[result.start_index], rel=1e-15)
        assert f"-{attributes['key'][:8]}." in path.name


def test_two_processes_give_the_numbers_of_one(small, started):
    write_experiment(small, CONFIG.replace("samples: 80", "samples: 80\n  replicates: 2"))
    for folder in ("one", "two"):
        assert noiseid("simulate", "--out", folder).exit_code == 0
    assert noiseid("estimate", "--out", "one").exit_code == 0
    two = started("estimate", "--out", "two", "--jobs", "2")
    assert two.communicate()[1].count("converged after") == 4
    assert two.returncode == 0
    for kind, count in (("datasets", 2), ("results", 4)):
        names = sorted(p.name for p in (small / "one/small" / kind).iterdir())
        assert len(names) == count
        assert names == sorted(p.name for p in (small / "two/small" / kind).iterdir())
        for name in names:
            assert arrays_of(small / "one/small" / kind / name) == arrays_of(small / "two/small" / kind / name)


def test_dry_run_says_what_would_be_done_and_does_nothing(small):
    before = files_of(small)
    told = noiseid("run", "--dry-run")
    assert told.exit_code == 0
    lines = told.stdout.splitlines()
    assert (lines[0], lines[2], len(lines)) == ("simulate: 1 dataset to do:", "estimate: 2 results to do:", 5)
    for command in ("simulate", "estimate"):
        assert noiseid(command, "-n", "-f").exit_code == 0
    assert files_of(small) == before
    noiseid("simulate")
    assert noiseid("run", "-n").stdout.startswith("simulate: nothing to do, 1 dataset there\nestimate: 2 results to do")
    assert noiseid("run", "-nf").stdout.startswith("simulate: 1 dataset to do:")
    data = json.loads(noiseid("run", "-n", "--json").stdout)
    assert [d["state"] for d in data["datasets"] + data["results"]] == ["there", "to do", "to do"]


def test_json_is_all_of_stdout_and_progress_all_of_stderr(small, started):
    process = started("run", "--json", "--verbose")
    out, err = process.communicate()
    assert process.returncode == 0
    data = json.loads(out)
    assert [unit["state"] for unit in data["datasets"] + data["results"]] == ["made"] * 3
    assert [unit["status"] for unit in data["results"]] == ["converged"] * 2
    assert data["report"] == "runs/small/report/report.md"
    assert {"std-process-noise", "before-after"} <= {table["name"] for table in data["tables"]}
    assert "  replicate-000/em/start-0: pass 2, log-likelihood " in err
    assert f"    {data['results'][0]['file']}" in err
    for command, keys in (("simulate", {"datasets"}), ("estimate", {"results", "report", "warnings", "tables"})):
        assert json.loads(noiseid(command, "--json").stdout).keys() == keys
    assert json.loads(noiseid("report", "--json").stdout)["warnings"] == []


def test_quiet_says_nothing_but_the_answer(small):
    result = noiseid("run", "--quiet")
    assert result.exit_code == 0
    assert result.stderr == ""
    assert "Standard deviations" in result.stdout
    assert noiseid("run", "-q", "--set", "simulate.samples=1").stderr.startswith("--set simulate.samples=1: simulate.")


def test_method_chooses_by_label_by_method_and_from_those_not_listed(small):
    write_experiment(small, CONFIG.replace("em: {}", "a: {method: em}\n    b: {method: em, acceleration: none}"))
    noiseid("simulate")

    def units(*flags):
        return [r["unit"] for r in json.loads(noiseid("estimate", "-n", "--json", *flags).stdout)["results"]]

    assert {u.split("/")[1] for u in units("-m", "b")} == {"b"}
    assert {u.split("/")[1] for u in units("--method", "em")} == {"a", "b"}
    assert {u.split("/")[1] for u in units("-m", "alg3", "-m", "a")} == {"alg3", "a"}
    before = files_of(small)
    wrong = noiseid("run", "-m", "c", "--force")
    assert wrong.exit_code == 3
    assert "'c' is not a method; known: a, b, em, " in wrong.stderr
    assert files_of(small) == before


def test_a_divergence_is_a_result_with_a_status_and_ends_with_4(small):
    far = ("--set", "estimate.initial_mean.known=[1e200, 0]")
    result = noiseid("run", *far)
    assert result.exit_code == 4
    assert "  replicate-000/em/start-0: diverged: the filter fails at the start values: test 'test 1'" in result.stderr
    assert "noiseid: estimate: 2 of 2 units did not converge: first, replicate-000/em/start-0 (diverged)" in (
        result.stderr.splitlines()
    )
    assert [read_result(path).estimate.status for path in results(small)] == ["diverged"] * 2
    # Nothing is left to do, but what is there is still not a success.
    for command in ("run", "estimate", "report"):
        assert noiseid(command, *far).exit_code == 4
    assert noiseid("simulate", *far).exit_code == 0


def test_a_unit_that_fails_does_not_lose_the_others(small):
    write_experiment(small, MEASURED)
    write_recordings(small)
    result = noiseid("run")
    assert result.exit_code == 4
    assert "noiseid: import: 1 of 2 units failed" in result.stderr.splitlines()
    assert "noiseid: report: 2 of 4 results are missing, the first is bad/em/start-0." in result.stderr.splitlines()
    assert len(results(small)) == 2
    assert "2 of 4 results are missing" in (small / "runs/small/report/report.md").read_text()
    # The estimates of the good recording are there: the same again, and by stage.
    assert [noiseid(command).exit_code for command in ("run", "import", "estimate", "report")] == [4, 4, 4, 4]
    mended = (small / "good.csv").read_text()
    (small / "bad.csv").write_text(mended)
    assert noiseid("run").exit_code == 0
    assert len(results(small)) == 4


def test_faults_of_a_recording_are_told_with_their_rows(small):
    write_experiment(small, MEASURED.replace("    good: {file: good.csv}\n", ""))
    write_recordings(small)
    result = noiseid("import")
    assert result.exit_code == 3
    for place in ("bad.csv, line 5: output 'x'", "line 9: time 0.06 s repeats that of line 8", "line 13: 0.5 s after"):
        assert place in result.stderr
    assert "Traceback" not in result.stderr
    # The row of the repeated stamp leaves a longer interval behind it: the fourth.
    assert result.stderr.count("4 faults in 1 recording") == 1
    policies = ("non_number=mark_missing", "repeated_stamp=drop", "gap=split", "unequal_interval=keep")
    flags = [flag for policy in policies for flag in ("--set", f"import.on_problem.{policy}")]
    assert noiseid("import", *flags).exit_code == 0


def test_the_wrong_stage_for_the_data_is_refused(small):
    result = noiseid("import")
    assert (result.exit_code, result.stderr.splitlines()[-1]) == (
        3,
        "noiseid: the experiment has no `import` section, it simulates its data: run `noiseid simulate`",
    )
    write_experiment(small, MEASURED)
    assert "run `noiseid import`" in noiseid("simulate").stderr
    write_experiment(small, CONFIG[: CONFIG.index("estimate:")])
    assert noiseid("run").stdout.startswith("simulate: 1 dataset made now:")
    assert "has no `estimate` section" in noiseid("estimate").stderr
    assert noiseid("run", "-m", "em").exit_code == 3


def test_what_a_killed_writer_left_is_swept_away(small):
    noiseid("simulate")
    folder = small / "runs/small/datasets"
    dead = folder / f"replicate-000.h5.{_machine()}-999999999-0.part"
    other = folder / "notes.part"
    dead.write_bytes(b"half")
    other.write_bytes(b"not ours")
    noiseid("simulate", "--dry-run")
    assert dead.exists()
    noiseid("simulate")
    assert not dead.exists()
    assert other.exists()


def test_a_damaged_result_is_named_put_aside_and_made_anew(small):
    noiseid("run")
    first, second = results(small)
    before, other = arrays_of(first), second.stat().st_mtime_ns
    first.write_bytes(first.read_bytes()[:-100])
    result = noiseid("run")
    assert result.exit_code == 0
    assert "replicate-000/em/start-0: runs/small/results/" in result.stderr
    assert "does not end in noiseid's checksum" in result.stderr
    assert f"It is kept as {first.name}.damaged." in result.stderr
    assert results(small) == [first, second]
    assert arrays_of(first) == before
    assert second.stat().st_mtime_ns == other


def test_another_process_compiles_nothing(small):
    assert noiseid("run").exit_code == 0
    again = subprocess.run([*COMMAND, "run", "--force", "--verbose"], capture_output=True, text=True, check=True)
    assert "pass 1, log-likelihood" in again.stderr  # it did the work, by kernels and equations that were there
    assert "ompil" not in again.stderr
