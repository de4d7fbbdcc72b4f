"""What is said about a wrong experiment, and where it points."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from noiseid_cli.config.load import builtin_experiment, load_experiment
from noiseid_cli.errors import ConfigError

SIX = """\
experiment: six_mistakes
sed: 3
model: {name: flexible_robot}
simulate:
  samples: 1_000
  trajectory: {kind: square, corner: [1.2, 0.7], side: -0.2, side_time: 0.5}
  process_noise: {std: [50, 20,
                        true, 15]}
estimate:
  process_noise:
    structure: ful
    start: {std: [50, 20, 30, 15]}
  measurement_noise: {known: {diag: [1, 1, 1, 1]}}
  initial_mean: {known: truth}
  initial_covariance: {known: {diag: [1, 1, 1, 1, 1, 1, 1, 1]}}
"""


@pytest.fixture
def problems(tmp_path):
    def check(text, *overrides, seed=None):
        file = tmp_path / "e.yaml"
        file.write_text(text)
        with pytest.raises(ConfigError) as caught:
            load_experiment(file, overrides, seed)
        return caught.value.problems

    return check


def test_six_mistakes_are_six_problems_each_in_its_place(problems):
    found = problems(SIX)
    assert [(p.line, p.column, p.path) for p in found] == [
        (2, 1, "sed"),
        (4, 1, "simulate.measurement_noise"),
        (5, 12, "simulate.samples"),
        (6, 56, "simulate.trajectory.side"),
        (8, 25, "simulate.process_noise.std.2"),
        (11, 16, "estimate.process_noise.structure"),
    ]
    said = [p.message for p in found]
    assert said[0].endswith("did you mean seed?")
    assert "is missing: true covariance of the measurement noise" in said[1]
    assert "without underscores" in said[2]
    assert "greater than 0, not -0.2 (length of a side, m)" in said[3]
    assert "must be a number, not true" in said[4]
    assert "full, diagonal, scale" in said[5]
    assert "did you mean full" in said[5]
    assert [p.excerpt for p in found] == [SIX.splitlines()[p.line - 1] for p in found]


def test_the_caret_stands_below_the_value(tmp_path):
    file = tmp_path / "e.yaml"
    file.write_text(SIX)
    with pytest.raises(ConfigError) as caught:
        load_experiment(file)
    lines = str(caught.value).splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith(f"{file}:6:56: simulate.trajectory.side: "))
    assert lines[at + 1][lines[at + 2].index("^") :].startswith("-0.2")


STARTER = builtin_experiment().read_text()

JOINT = (
    "{kind: s_curve, input: a, output: b, between: [0, 1], move_time: 2, dwell: 0.2, HOLD, "
    "position_gain: 1, speed_gain: 1, cutoff: 1}"
)
SQUARE = "{kind: square, corner: [1.2, 0.7], side: 0.2, side_time: 0.5}"

ONE_MISTAKE = [
    (SQUARE, JOINT.replace("HOLD", "hold: {begin: 10.5, end: 12}"), "simulate.trajectory.hold.begin",
     "the reference moves at 10.5 s; it rests from 10.8 to 11 s"),
    (SQUARE, JOINT.replace("HOLD", "hold: {begin: 2, end: 2}"), "simulate.trajectory.hold.end",
     "must be after begin, 2 s, not 2"),
    (SQUARE, JOINT.replace("dwell: 0.2, HOLD", "dwell: -1"), "simulate.trajectory.dwell", "at least 0, not -1"),
    (SQUARE, "{kind: multisine, amplitude: [1, 1], lowest: 2, highest: 1, lines: 3}", "simulate.trajectory.highest",
     "must be at least lowest, 2 Hz, not 1"),
    ("samples: 4000", "samples: 9\n  parameter_changes: [{at: 1}]", "simulate.parameter_changes.0",
     "changes nothing: give set or scale"),
    ("samples: 4000", "samples: 9\n  parameter_changes: [{at: 1, set: {a: 1}, scale: {a: 1}}]",
     "simulate.parameter_changes.0.scale.a", "stands in set too"),
    ("samples: 4000", "samples: 9\n  parameter_changes: [{at: 0, set: {a: 1}}]", "simulate.parameter_changes.0.at",
     "greater than 0, not 0"),
    ("experiment: flexible_robot", "experiment: ../x", "experiment", "is not a label"),
    ("experiment: flexible_robot", "experiment: 2011", "experiment", "must be text, not 2011: put it in quotes"),
    ("experiment: flexible_robot", "", "experiment", "is missing: name of the experiment"),
    ("seed: 2012", "seed: 1.5", "seed", "must be a whole number, not 1.5"),
    ("seed: 2012", "seed: true", "seed", "must be a whole number, not true"),
    ("seed: 2012", "seed: -1", "seed", "must be at least 0, not -1"),
    ("seed: 2012", "seed: 0x1F", "seed", "not a decimal number"),
    ("seed: 2012", "seed:", "seed", "is empty, but must be a whole number"),
    ("seed: 2012", "seed:2011\nx: 1", "", "a colon is followed by a blank"),
    ("seed: 2012", "Seed: 2011", "Seed", "did you mean seed?"),
    ("name: flexible_robot", "nam: flexible_robot", "model.nam", "did you mean name?"),
    ("name: flexible_robot", "class: A", "model", "file is missing"),
    ("name: flexible_robot", "file: a.py", "model", "class is missing"),
    ("name: flexible_robot", "name: a\n  file: a.py\n  class: A", "model", "give one of: name; file and class; linear"),
    ("samples: 4000", "samples: 1", "simulate.samples", "at least 2, not 1"),
    ("samples: 4000", 'samples: "4000"', "simulate.samples", "without quotes"),
    ("samples: 4000", "samples: 1:30", "simulate.samples", "give times in seconds"),
    ("samples: 4000", "samples: 4000.5", "simulate.samples", "whole number, not 4000.5"),
    ("samples: 4000", "samples: 1e19", "simulate.samples", "whole number, not 1e+19"),
    ("samples: 4000", "samples: [4000]", "simulate.samples", "not a list"),
    ("side: 0.2", "side: .nan", "simulate.trajectory.side", "must be a finite number, not nan"),
    ("side: 0.2", "side: .inf", "simulate.trajectory.side", "must be a finite number, not inf"),
    ("side: 0.2", "side: no", "simulate.trajectory.side", "not the text 'no'"),
    ("side: 0.2", "side: {}", "simulate.trajectory.side", "not a mapping"),
    ("side: 0.2", "sid: 0.2, side: 1", "simulate.trajectory.sid", "kind, corner, side, side_time"),
    ("side: 0.2,", "", "simulate.trajectory.side", "is missing: length of a side, m"),
    ("kind: square", "kind: squared", "simulate.trajectory.kind", "did you mean square?"),
    ("kind: square, ", "", "simulate.trajectory.kind", "square, zero, multisine, steps"),
    ("corner: [1.2, 0.7]", "corner: [1.2]", "simulate.trajectory.corner", "too few"),
    ("corner: [1.2, 0.7]", "corner: [1, 2, 3]", "simulate.trajectory.corner", "at most 2 entries, not 3"),
    ("corner: [1.2, 0.7]", "corner: [1, 'a']", "simulate.trajectory.corner.1", "must be a number"),
    ("{kind: square, corner: [1.2, 0.7], side: 0.2, side_time: 0.5}", "square", "simulate.trajectory", "mapping"),
    ("{std: [50, 20, 30, 15]}     ", "[50, 20]", "simulate.process_noise", "must be a mapping"),
    ("{std: [50, 20, 30, 15]}     ", "{std: []}", "simulate.process_noise.std", "at least 1 entry, not 0"),
    ("{std: [50, 20, 30, 15]}     ", "{std: 50}", "simulate.process_noise.std", "must be a list"),
    ("{std: [50, 20, 30, 15]}     ", "{var: [50]}", "simulate.process_noise.var", "known: std, correlation, diag"),
    ("structure: full", "structure: [full]", "estimate.process_noise.structure", "must be one of full"),
    ("structure: full", "structure: {block: [[a]]}", "estimate.process_noise.structure.block", "mean blocks"),
    ("structure: full", "structure: {blocks: [[a, b], [a]]}", "estimate.process_noise.structure.blocks.1.0", "already"),
    ("structure: full", "fixed: [a, [a, b, c]]", "estimate.process_noise.fixed.1", "must be a name"),
    ("structure: full", "fixed: [1]", "estimate.process_noise.fixed.0", "must be a name"),
    ("structure: full", "fixed: [a]\n    structure: scale", "estimate.process_noise.fixed", "only the factor"),
    ("structure: full", "known: {std: [1]}", "estimate.process_noise", "either known"),
    ("known: truth", "known: true", "estimate.initial_mean.known", "must be truth, a list"),
    ("known: truth", "known: [1, x]", "estimate.initial_mean.known", "must be a number"),
    ("known: truth", "start: truth, known: truth", "estimate.initial_mean", "either known"),
    ("scale: [0.01, 100]", "scale: [0.01, 0]", "estimate.starts.scale.1", "greater than 0, not 0"),
    ("scale: [0.01, 100]", "scale: [1], measurement_scale: [1, 2]", "estimate.starts.measurement_scale", "scale has 1"),
    ("em: {}", "mle: {}", "estimate.methods.mle.method", "known: em"),
    ("em: {}", "em: 3", "estimate.methods.em", "must be a mapping"),
    ("em: {}", "EM-plain: {method: em}", "estimate.methods.em-plain", "upper and lower case"),
    ("em: {}", "a/b: {method: em}", 'estimate.methods.a/b', "is not a label"),
    ("em: {}", "em: {stop: never}", "estimate.methods.em.stop", "both, loglik, parameters"),
    ("em: {}", "em: {fall_tolerance: -1}", "estimate.methods.em.fall_tolerance", "nats"),
    ("title: Flexible", "titel: Flexible", "report.titel", "did you mean title?"),
    ("title: Flexible robot, process noise by EM", "formats: [html, pdf]", "report.formats.1", "md, csv, tex"),
    ("title: Flexible robot, process noise by EM", "formats: [md, md]", "report.formats", "twice"),
    ("title: Flexible robot, process noise by EM", "formats: []", "report.formats", "at least 1 entry"),
    ("title: Flexible robot, process noise by EM", "title: ''", "report.title", "must not be empty"),
    ("report:", "import: {}\nreport:", "", "either simulate or import"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "path", "said"), ONE_MISTAKE)
def test_each_mistake_is_named_in_its_place(problems, old, new, path, said):
    assert old in STARTER
    found = problems(STARTER.replace(old, new, 1))
    hit = [p for p in found if p.path.startswith(path) and said in p.message]
    assert len(hit) == 1, found
    assert new == "" or any(p.excerpt.strip() for p in hit)
    for problem in found:
        assert "Input" not in problem.message


def test_neither_source_of_data(problems):
    assert "must come from somewhere" in problems("experiment: a\nmodel: {name: b}")[0].message


def test_the_choice_of_data_is_checked_beside_other_mistakes(problems):
    found = problems("experiment: 3\nmodel: {name: b}")
    assert [(p.line, p.path) for p in found] == [(1, ""), (1, "experiment")]


def test_a_faulty_value_is_complained_about_once(problems):
    found = problems(STARTER.replace("samples: 4000", "samples: 010").replace("seed: 2012", "seed: !!int 3"))
    assert [(p.line, p.path) for p in found] == [(4, "seed"), (10, "simulate.samples")]


def test_a_missing_colon_blank_is_guessed(problems):
    found = problems(STARTER.replace("kind: square", "kind:square"))
    assert any("blank missing after the colon" in p.message for p in found)


def test_at_most_fifty_problems_are_shown(problems):
    found = problems(STARTER.replace("scale: [0.01, 100]", "scale: [" + "-1, " * 80 + "]"))
    assert len(found) == 51
    assert found[-1].message == "30 more problems follow"


VALUES = ["", "1", "-1", "1.5", "true", "[]", "[1]", "[[1, 2], [2, 1]]", "{}", "{a: 1}", "x", ".nan", "'1'", "null",
          "{kind: zero}", "{std: [1]}", "[a, [b, c]]", "{known: 3}",
          "{blocks: [[a], 1]}", "{em: {method: x}}", "{kind: zero, 'a:b': 1}", "{'kind:zero': 1}"]  # fmt: skip


def paths(data, here=()):
    """All paths of nested settings."""
    for key, value in data.items() if isinstance(data, dict) else enumerate(data):
        yield (*here, key)
        if isinstance(value, dict | list):
            yield from paths(value, (*here, key))


EVERY_PATH = [".".join(map(str, p)) for p in paths(load_experiment(builtin_experiment()).resolved())]
MEASURED = "configs/double_pendulum_measured.yaml"
EVERY_MEASURED = [".".join(map(str, p)) for p in paths(load_experiment(MEASURED).resolved())]


@given(st.integers(0, 2**32))
@settings(max_examples=400)
def test_any_value_anywhere_is_taken_or_refused_in_plain_words(seed):
    rng = random.Random(seed)
    file, known = rng.choice([(builtin_experiment(), EVERY_PATH), (MEASURED, EVERY_MEASURED)])
    overrides = [f"{rng.choice(known)}={rng.choice(VALUES)}" for _ in range(rng.randint(1, 3))]
    said = ""
    try:
        load_experiment(file, overrides).resolved()
    except ConfigError as error:
        said = str(error)
    for words in ("Input", "pydantic", "function", "[type=", "dictionary", "literal[", "Options", "tuple"):
        assert words not in said
