import pytest

from noiseid_cli.config.load import builtin_experiment, load_experiment
from noiseid_cli.errors import ConfigError

START = builtin_experiment()


def load(*overrides, seed=None):
    return load_experiment(START, overrides, seed).experiment


def test_values_follow_the_rules_of_the_file():
    got = load("simulate.samples=1e3", "report.title=no", "simulate.trajectory.side=5E-1")
    assert got.simulate.samples == 1000
    assert got.report.title == "no"
    assert got.simulate.trajectory.side == 0.5


def test_entries_of_lists_and_whole_mappings():
    got = load(
        "simulate.process_noise.std.1=7",
        "simulate.trajectory={kind: zero}",
        "estimate.methods.em={stop: loglik}",
    )
    assert got.simulate.process_noise.std == (50.0, 7.0, 30.0, 15.0)
    assert got.simulate.trajectory.kind == "zero"
    assert got.estimate.methods["em"].stop == "loglik"


def test_mappings_on_the_way_are_made():
    got = load("model.parameters.g=9.8", 'model.parameters."a.b"=1', "estimate.methods.new.method=em")
    assert got.model.parameters == {"g": 9.8, "a.b": 1.0}
    assert list(got.estimate.methods) == ["em", "em-plain", "new"]


def test_the_last_of_two_wins_and_seed_wins_over_set():
    assert load("seed=3", "seed=4").seed == 4
    assert load("seed=3", seed=5).seed == 5


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("seed", "--set seed: must be of the form PATH=VALUE"),
        ("=3", "is not a path of settings"),
        ("a..b=3", "is not a path of settings"),
        ("a.=3", "is not a path of settings"),
        ('a."b=3', "is not a path of settings"),
        ("seed=x", "--set seed=x: seed: must be a whole number, not the text 'x'"),
        ("seed=010", "--set seed=010: 010 starts with a needless zero"),
        ("seed=[1", "--set seed=[1: not valid YAML: a list that was opened"),
        ("seed=&a 3", "--set seed=&a 3: anchors"),
        ("sede=3", "--set sede=3: sede: is not a setting here"),
        ("seed.x=3", "seed holds a single value"),
        ("simulate.process_noise.std.4=3", "has 4 entries: 4 must be 0 to 3"),
        ("simulate.process_noise.std.-1=3", "is a list: '-1' must be the number of an entry"),
        ("simulate.process_noise.std.x=3", "is a list: 'x' must be the number of an entry"),
        ("simulate.process_noise.std.0=-3", "simulate.process_noise.std.0: must be at least 0, not -3"),
        (
            "simulate.trajectory={kind: zero, side: 2}",
            "simulate.trajectory.side: is not a setting here; known: kind",
        ),
        (
            "estimate.methods.new.metod=em",
            "--set estimate.methods.new.metod=em: estimate.methods.new.method: 'new'",
        ),
        ("simulate.samples=", "simulate.samples: is empty"),
    ],
)
def test_complaints_name_the_override(override, said):
    with pytest.raises(ConfigError) as caught:
        load(override)
    assert said in str(caught.value)
    assert all(line.startswith("--set ") for line in caught.value.lines())


def test_file_and_overrides_are_complained_about_together(tmp_path):
    file = tmp_path / "e.yaml"
    file.write_text(START.read_text().replace("samples: 4000", "samples: 1"))
    with pytest.raises(ConfigError) as caught:
        load_experiment(file, ["a.b", "report.title=[]"], seed=-1)
    assert {(p.source, p.path) for p in caught.value.problems} == {
        ("--set a.b", ""),
        ("--set report.title=[]", "report.title"),
        ("--seed -1", "seed"),
        ("", "simulate.samples"),
    }


def test_an_override_repairs_the_file(tmp_path):
    file = tmp_path / "e.yaml"
    file.write_text(START.read_text().replace("samples: 4000", "samples: 010"))
    with pytest.raises(ConfigError):
        load_experiment(file)
    file.write_text(START.read_text().replace("samples: 4000", "samples: x"))
    assert load_experiment(file, ["simulate.samples=12"]).experiment.simulate.samples == 12
