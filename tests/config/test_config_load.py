import json
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from noiseid_cli.config.load import builtin_experiment, find_experiment, load_experiment
from noiseid_cli.config.schema import Experiment
from noiseid_cli.errors import ConfigError

SHIPPED = [builtin_experiment(), *sorted(Path("configs").glob("*.yaml"))]
STARTER = builtin_experiment().read_text()


def key(tmp_path, text, *sections):
    file = tmp_path / "e.yaml"
    file.write_text(text)
    return load_experiment(file).section_key(*sections)


@pytest.mark.parametrize("file", SHIPPED, ids=lambda f: f.name)
def test_shipped_experiments_load_and_resolved_loads_again(file):
    loaded = load_experiment(file)
    resolved = loaded.resolved()
    assert Experiment.model_validate(json.loads(json.dumps(resolved))) == loaded.experiment
    assert list(resolved) == sorted(resolved)
    assert loaded.text == file.read_text()
    assert loaded.positions[("experiment",)].key[1] == 1


def test_defaults_are_filled_in():
    resolved = load_experiment(builtin_experiment()).resolved()
    assert resolved["simulate"]["tests"] == 1
    assert resolved["estimate"]["methods"]["em"]["max_passes"] == 500
    assert resolved["estimate"]["methods"]["em-plain"]["max_passes"] == 1000
    assert resolved["report"]["formats"] == ["html", "md", "csv", "tex", "svg", "png"]
    assert "import" not in resolved


SAME = [
    ("# A flexible", "# Another"),
    ("seed: 2012\n", ""),
    ("seed: 2012", "seed: 2012.0"),
    ("[50, 20, 30, 15]", "[50.0, 2e1, 3.0E+1, 15.]"),
    ("samples: 4000", "tests: 1\n  samples: 4e3"),
    ("{kind: square, corner: [1.2, 0.7], side: 0.2,", "{side: 0.2, kind: 'square', corner: [1.2, 0.7],"),
    ("EM\n", "EM, and more\n"),
]
OTHER = [
    ("samples: 4000", "samples: 4001"),
    ("side: 0.2", "side: 0.20000000000000004"),
    ("process_noise: {std: [50, 20, 30, 15]}", "process_noise: {std: [50, 20, 15, 30]}"),
    ("samples: 4000", "samples: 4000\n  sample_time: 1e-3"),
]


@pytest.mark.parametrize(("old", "new"), SAME)
def test_the_key_of_a_section_does_not_change_with_its_writing(tmp_path, old, new):
    assert old in STARTER
    assert key(tmp_path, STARTER.replace(old, new), "model", "simulate") == key(tmp_path, STARTER, "simulate", "model")


@pytest.mark.parametrize(("old", "new"), OTHER)
def test_the_key_of_a_section_changes_with_its_values(tmp_path, old, new):
    assert old in STARTER
    changed = STARTER.replace(old, new, 1)
    assert key(tmp_path, changed, "model", "simulate") != key(tmp_path, STARTER, "model", "simulate")
    assert key(tmp_path, changed, "report") == key(tmp_path, STARTER, "report")


def test_keys_of_parts():
    loaded = load_experiment(builtin_experiment())
    names = ["seed", "model", "simulate", "import", "estimate", ("estimate", "methods", "em"), ("estimate", "starts")]
    keys = [loaded.section_key(name) for name in names]
    assert len(set(keys)) == len(keys)
    assert all(len(k) == 64 and int(k, 16) for k in keys)


@given(st.randoms(use_true_random=False))
@settings(max_examples=25)
def test_the_order_of_keys_plays_no_part(tmp_path_factory, random):
    def shuffled(value):
        if isinstance(value, dict):
            keys = list(value)
            random.shuffle(keys)
            return {k: shuffled(value[k]) for k in keys}
        return value

    loaded = load_experiment(builtin_experiment())
    file = tmp_path_factory.getbasetemp() / "shuffled.yaml"
    file.write_text(json.dumps(shuffled(loaded.resolved()), indent=1))
    again = load_experiment(file)
    assert again.resolved() == loaded.resolved()
    assert again.section_key("simulate", "estimate") == loaded.section_key("simulate", "estimate")


def test_methods_keep_their_order(tmp_path):
    text = STARTER.replace("em: {}", "zz: {method: em}\n    aa: {method: em}")
    file = tmp_path / "e.yaml"
    file.write_text(text)
    assert list(load_experiment(file).experiment.estimate.methods) == ["zz", "aa", "em-plain"]


def test_relative_paths_start_at_the_folder_of_the_file(tmp_path):
    file = tmp_path / "e.yaml"
    file.write_text(STARTER)
    loaded = load_experiment(file)
    assert loaded.folder == tmp_path
    assert loaded.resolve("../data.csv") == tmp_path.parent.resolve() / "data.csv"
    assert loaded.resolve("/data.csv") == Path("/data.csv").resolve()


def test_which_experiment_is_taken(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file, sentence = find_experiment()
    assert file == builtin_experiment()
    assert "built-in flexible_robot" in sentence
    Path("noiseid.yaml").write_text(STARTER)
    file, sentence = find_experiment()
    assert load_experiment(file).file == Path("noiseid.yaml")
    assert "in this folder" in sentence
    assert find_experiment("other.yaml") == (Path("other.yaml"), "experiment: other.yaml")


def test_the_message_names_the_file_as_given(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("e.yaml").write_text("x: 1")
    with pytest.raises(ConfigError, match=r"(?m)^e\.yaml:1:1: x: is not a setting"):
        load_experiment("e.yaml")


def test_pydantic_comes_only_with_a_config():
    code = (
        "import sys, noiseid_cli.config.load as l; assert 'pydantic' not in sys.modules; "
        "l.load_experiment(l.builtin_experiment()); assert 'pydantic' in sys.modules; "
        "assert not {'sympy', 'numba', 'scipy', 'h5py', 'matplotlib'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
