"""The report of an experiment: from all results, from some of them, and again only if something has changed."""

import json

import pytest
from small_experiment import CONFIG, files_of

from noiseid_cli.errors import ConfigError, DataError
from noiseid_cli.pipeline.context import open_experiment
from noiseid_cli.pipeline.engine import run_units
from noiseid_cli.pipeline.reporting import citations, gather, make_report_stage, show_results
from noiseid_cli.pipeline.units import dataset_units, estimate_units


class Silent:
    """A listener that does not listen."""

    def __getattr__(self, name):
        return lambda *_: None


def opened(file, *overrides):
    return open_experiment(file, file.parent / "runs", overrides)


@pytest.fixture
def done(small):
    """The small experiment with its results."""
    context = opened(small)
    for stage, units in (("simulate", dataset_units), ("estimate", estimate_units)):
        run_units(context, stage, units(context), Silent())
    return context


def test_the_study_holds_what_ran(done):
    study, sources = gather(done)
    assert [r.unit for r in study.results] == ["replicate-000/em/start-0", "replicate-000/em/start-1"]
    assert study.warnings == []
    assert (study.title, study.experiment) == ("small", "small")
    assert json.loads(study.reproduce[1]) == done.loaded.resolved()
    (data,) = study.datasets
    assert (data.name, data.tests, data.samples, data.origin) == (
        "replicate-000", 1, 80, "simulated, trajectory multisine"
    )  # fmt: skip
    assert data.duration == pytest.approx(0.79)
    assert study.model.name == "cart"
    assert study.citations == citations(done)
    assert study.citations[-1] == "A cart of our own."
    assert len(sources) == 3


def test_without_results_there_is_no_report(small):
    with pytest.raises(DataError, match="there are no results of this experiment"):
        make_report_stage(opened(small))


def test_a_report_from_partial_results_carries_a_warning(done):
    first, second = estimate_units(done)
    second.path.unlink()
    reported = make_report_stage(done)
    warning = "1 of 2 results are missing, the first is replicate-000/em/start-1."
    assert reported.warnings == [warning]
    assert warning in reported.page.read_text().replace("\\", "")
    # One that is damaged is left out, and named.
    second.path.write_bytes(first.path.read_bytes()[:-9])
    (told,) = show_results(done).warnings
    assert told.startswith(f"Left out: {second.path} ")
    first.path.write_bytes(b"")
    with pytest.raises(DataError, match="is empty"):
        show_results(done)


def test_a_report_is_left_alone_until_something_changes(done, small):
    assert make_report_stage(done).written
    folder = done.folder / "report"
    before = files_of(folder)
    again = make_report_stage(done, anew=False)
    assert (again.written, again.page) == (False, folder / "report.md")
    assert files_of(folder) == before
    for change in ("report.title=Other", "report.formats=[md]"):
        assert make_report_stage(opened(small, change), anew=False).written
    assert make_report_stage(done).written  # when it is asked for
    (folder / "results.csv").unlink()
    assert make_report_stage(done, anew=False).written
    run_units(done, "estimate", estimate_units(done), Silent(), force=True)
    assert make_report_stage(done, anew=False).written


def test_what_an_earlier_report_wrote_is_removed_and_nothing_else(done, small):
    make_report_stage(done)
    folder = done.folder / "report"
    (folder / "notes.txt").write_text("mine")
    assert (folder / "results.csv").exists()
    make_report_stage(opened(small, "report.formats=[md]"))
    assert sorted(p.name for p in folder.rglob("*") if p.is_file()) == [".report.json", "notes.txt", "report.md"]


@pytest.mark.parametrize("index", ["", "[]", '{"files": ["../../cart.py", "report.md"]}', '{"files": ["/etc/hosts"]}'])
def test_an_index_that_is_not_ours_removes_nothing(done, small, index):
    folder = done.folder / "report"
    folder.mkdir()
    (folder / ".report.json").write_text(index)
    assert make_report_stage(done, anew=False).written
    assert (small.parent / "cart.py").exists()


def test_published_figures_are_read_before_anything_runs(small):
    small.write_text(CONFIG.replace("[csv, md]", "[csv, md], published: nowhere.yaml"))
    with pytest.raises((DataError, ConfigError), match=r"nowhere\.yaml"):
        opened(small)


def test_results_that_did_not_converge_are_counted(small):
    context = opened(small, "estimate.methods.em.max_passes=2")
    for stage, units in (("simulate", dataset_units), ("estimate", estimate_units)):
        run_units(context, stage, units(context), Silent())
    assert show_results(context).unfinished == 2
