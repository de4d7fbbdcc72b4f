"""The commands that show something: help, models, methods, files, settings, what to cite."""

import importlib.util
import json
import re

import pytest
from small_experiment import CONFIG, MEASURED, files_of, noiseid, write_experiment, write_recordings

from noiseid_cli.config.load import load_experiment
from noiseid_cli.config.methods import METHOD_OPTIONS
from noiseid_cli.models.registry import model_names

COMMANDS = [
    "run",
    "simulate",
    "import",
    "estimate",
    "report",
    "diagnose",
    "export",
    "status",
    "check",
    "init",
    "inspect",
    "diff",
    "methods",
    "cite",
    "env",
    "schema",
    "models",
]


def test_help_names_every_command_and_cuts_no_sentence(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    text = noiseid("--help").stdout
    listed = text[text.index("Commands:") :]
    assert re.findall(r"^  ([a-z]+)  ", listed, re.MULTILINE) == COMMANDS
    assert "..." not in listed
    assert max(map(len, text.splitlines())) <= 80
    assert noiseid().output == text


@pytest.mark.parametrize("command", [*COMMANDS, "models show"])
def test_help_of_each_command_is_readable(command, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    result = noiseid(*command.split(), "-h")
    assert result.exit_code == 0
    assert max(map(len, result.stdout.splitlines())) <= 80
    assert "list[str]" not in result.stdout
    assert "int range" not in result.stdout


def test_init_writes_an_experiment_that_runs(empty):
    written = noiseid("init")
    assert written.stdout.splitlines()[0] == "wrote noiseid.yaml"
    told = noiseid("check")
    assert told.stdout.splitlines()[0] == "noiseid.yaml: no mistakes found"
    assert noiseid("run", "-q", "--set", "simulate.samples=150", "--set", "report.formats=[md]").exit_code == 0
    assert (empty / "runs/my_experiment/report/report.md").exists()
    text = (empty / "noiseid.yaml").read_text()
    assert max(map(len, text.splitlines())) <= 120
    (empty / "noiseid.yaml").write_text("mine")
    assert noiseid("init").exit_code == 3
    assert (empty / "noiseid.yaml").read_text() == "mine"
    assert noiseid("init", "--force").exit_code == 0
    assert (empty / "noiseid.yaml").read_text() == text
    assert noiseid("init", "other/exp.yaml").stdout.splitlines()[2] == "  noiseid run other/exp.yaml     runs it"


def test_what_init_leaves_in_comments_is_right_too(empty):
    """Each setting that stands in a comment of the starter loads where it stands."""
    noiseid("init")
    lines = (empty / "noiseid.yaml").read_text().splitlines()
    at = next(i for i, line in enumerate(lines) if line == "# import:")
    commented = re.compile(r"^( +)# ([a-z-]+: .*)$")
    text = "\n".join(commented.sub(r"\1\2", line) for line in lines[:at])
    (empty / "all.yaml").write_text(text)
    told = json.loads(noiseid("check", "all.yaml", "--json").stdout)
    assert (told["simulate"]["tests"], told["simulate"]["replicates"]) == (4, 10)
    assert list(told["estimate"]["methods"]) == ["em", "em-published"]
    start, end = (next(i for i, line in enumerate(lines) if line == word) for word in ("simulate:", "estimate:"))
    recorded = [*lines[:start], *(line.removeprefix("# ") for line in lines[at:]), *lines[end:at]]
    (empty / "recorded.yaml").write_text("\n".join(recorded).replace("known: truth", "known: [0, 0, 0, 0, 0, 0, 0, 0]"))
    loaded = load_experiment(empty / "recorded.yaml")
    assert list(loaded.experiment.import_.recordings) == ["monday", "tuesday"]


def test_check_tells_what_there_is(small):
    before = files_of(small)
    told = noiseid("check")
    assert told.exit_code == 0
    assert re.sub("; .* are free", "; lots", told.stdout).splitlines() == [
        "noiseid.yaml: no mistakes found",
        "  model     cart: 2 states, 1 input, 1 noise, 1 output",
        "  simulate  1 unit, 0 there already",
        "  estimate  2 units, 0 there already",
        "  memory    about 0.0623 MiB at once for the largest unit; lots",
        "  folder    runs/small",
    ]
    assert files_of(small) == before
    noiseid("run", "-q", "--out", "here")
    assert "  estimate  2 units, 2 there already" in noiseid("check", "-o", "here").stdout.splitlines()
    assert json.loads(noiseid("check", "--json", "--seed", "3").stdout)["seed"] == 3
    write_experiment(small, MEASURED)
    missing = noiseid("check")
    assert missing.exit_code == 3
    for place, name in (("6:18", "good"), ("7:17", "bad")):
        assert (
            f"noiseid.yaml:{place}: import.recordings.{name}.file: {small}/{name}.csv cannot be found" in missing.stderr
        )
    write_recordings(small)
    assert "  import    2 units, 0 there already" in noiseid("check").stdout.splitlines()


@pytest.mark.parametrize("columns", [80, 120])
@pytest.mark.parametrize("name", [*model_names(), "cart.py:Cart"])
def test_a_model_is_shown_within_the_width(small, monkeypatch, name, columns):
    monkeypatch.setenv("COLUMNS", str(columns))
    result = noiseid("models", "show", name)
    assert result.exit_code == 0
    lines = result.stdout.splitlines()
    assert max(map(len, lines)) <= columns
    for title in ("dynamics", "output equations", "states", "inputs", "noises", "outputs", "parameters"):
        assert title in lines
    # In a table each column begins at its heading.
    at = lines.index("parameters")
    headings = [match.start() for match in re.finditer(r"\S+", lines[at + 1])]
    assert len(headings) == 5
    for line in lines[at + 2 : lines.index("", at)]:
        assert all(line[start - 1 : start].strip() == "" for start in headings if start < len(line))


@pytest.mark.parametrize("name", [*model_names(), "cart.py:Cart"])
def test_latex_is_one_align_environment(small, name):
    text = noiseid("models", "show", name, "--latex").stdout
    first, *rows, last = text.splitlines()
    assert (first, last) == (r"\begin{align*}", r"\end{align*}")
    # A choice of branches has columns of its own.
    rows = [re.sub(r"\\begin{cases}.*?\\end{cases}", "c", row) for row in rows]
    for number, row in enumerate(rows, 1):
        assert row.count("&") == 1
        assert row.endswith(r" \\") == (number < len(rows))
        assert row.count("{") == row.count("}")
        assert row.count(r"\left") == row.count(r"\right")
        depth = 0
        for letter in row:
            depth += (letter == "{") - (letter == "}")
            assert depth >= 0
    assert len(rows) == len(json.loads(noiseid("models", "show", name, "--json").stdout)["equations"])


def test_models_are_listed(empty):
    told = json.loads(noiseid("models", "--json").stdout)
    assert tuple(told) == model_names()
    lines = noiseid("models").stdout.splitlines()
    assert [line.split()[0] for line in lines if line[:1].strip() and line[0] != "`"] == list(model_names())


def test_methods_are_listed_with_their_options(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    told = json.loads(noiseid("methods", "--json").stdout)
    assert list(told) == list(METHOD_OPTIONS)
    assert told["em"]["options"]["max_passes"]["default"] == 500
    text = noiseid("methods").stdout
    assert max(map(len, text.splitlines())) <= 80
    for name, method in told.items():
        assert f"\n{name}: " in f"\n{text}"
        for option in method["options"]:
            assert f"\n    {option} " in text
    assert "(default 1e-05)" in text


def test_inspect_shows_data_results_and_settings(small):
    noiseid("run", "-q")
    (data,) = (small / "runs/small/datasets").iterdir()
    results = sorted((small / "runs/small/results").iterdir())
    told = noiseid("inspect", str(data)).stdout
    assert re.search(r"^tests +test 1: 80 samples, 0.79 s$", told, re.MULTILINE)
    assert re.search(r"^missing +0 of 80 measurements$", told, re.MULTILINE)
    assert re.search(r"^inputs +f N$", told, re.MULTILINE)
    facts = json.loads(noiseid("inspect", "--json", str(data)).stdout)
    assert facts["tests"] == [{"name": "test 1", "samples": 80, "seconds": pytest.approx(0.79)}]
    assert (facts["missing"], facts["truth"]) == (0, True)
    first, second = json.loads(noiseid("inspect", "--json", *map(str, results)).stdout)
    assert (first["result"], second["result"]) == ("replicate-000/em/start-0", "replicate-000/em/start-1")
    assert first["status"] == "converged"
    assert len(first["Q"]) == 1
    assert re.search(r"^Q +standard deviations v [0-9.]+ N$", noiseid("inspect", str(results[0])).stdout, re.MULTILINE)
    settings = json.loads(noiseid("inspect", "--config", str(data)).stdout)
    assert settings == load_experiment(small / "noiseid.yaml").resolved()


def test_cite_env_and_schema(small):
    assert noiseid("cite").stdout.splitlines()[-1] == "- A cart of our own."
    papers = json.loads(noiseid("cite", "--json", "-m", "alg3", "-q").stdout)
    assert papers == [METHOD_OPTIONS["alg3"].citation, "A cart of our own."]
    # What to cite can be told before the data are there, and where nothing is estimated.
    write_experiment(small, MEASURED)
    assert noiseid("cite").exit_code == 0
    write_experiment(small, CONFIG[: CONFIG.index("estimate:")])
    assert json.loads(noiseid("cite", "--json").stdout) == ["A cart of our own."]
    facts = json.loads(noiseid("env", "--json").stdout)
    assert {"noiseid", "python", "numpy", "numba", "cpu", "blas", "model cache"} <= facts.keys()
    assert [line.split()[0] for line in noiseid("env").stdout.splitlines()][:2] == ["noiseid", "python"]
    assert json.loads(noiseid("schema").stdout)["title"] == "noiseid experiment"


@pytest.mark.skipif(not importlib.util.find_spec("xarray"), reason="xarray is an extra")
def test_xarray_opens_a_dataset_as_it_is(small):
    import xarray

    noiseid("simulate")
    (file,) = (small / "runs/small/datasets").iterdir()
    with xarray.open_dataset(file) as data:
        assert data["y"].dims == ("test", "sample", "output")
        assert data["y"].attrs["units"] == "m"
        assert json.loads(data.attrs["config"])["seed"] == 7
