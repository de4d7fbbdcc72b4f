"""Every option at a value other than its default, and every covariance form."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from noiseid_cli.config.covariance import Covariance, smallest_eigenvalue
from noiseid_cli.config.load import load_experiment
from noiseid_cli.config.method_base import MethodOptions
from noiseid_cli.config.methods import METHOD_OPTIONS
from noiseid_cli.errors import ConfigError

SIMULATED = """
experiment: all.options_1
seed: 1234567890123456789
model: {name: robot, parameters: {g: 9.8, m: 1}, discretisation: rk4}
simulate:
  samples: 2e2
  sample_time: 1e-3
  tests: 3
  replicates: 4
  trajectory: {kind: multisine, amplitude: [1, 0], lowest: 0.1, highest: 20, lines: 7}
  process_noise: {std: [1, 2], correlation: [[1, -0.5], [-0.5, 1]]}
  measurement_noise: {full: [[2, 1], [1, 2]]}
  parameter_changes: [{at: 0.1, set: {g: 2}}, {at: 0.15, scale: {m: 3, g: 4}}]
  initial_state: [0.1, -0.2]
  held_out: {tests: 2, trajectory: {kind: steps, amplitude: [3, 4], hold: 0.5}}
estimate:
  process_noise: {start: {diag: [1, 4]}, structure: {blocks: [[a], [b]]}, fixed: [a, [a, b]]}
  measurement_noise: {start: {std: [1, 2]}, structure: scale}
  initial_mean: {start: [0, 1]}
  initial_covariance: {start: {std: [1, 1]}, structure: diagonal, fixed: [x]}
  starts: {scale: [0.1, 1, 10], measurement_scale: [1, 2, 3]}
  methods:
    em:
    slow:
      method: em
      structure: diagonal
      linearisation: filtered
      acceleration: none
      max_passes: 7
      loglik_tolerance: 0
      parameter_tolerance: 1e-6
      stop: loglik
      fall_tolerance: 0.5
    path: {method: alg2, optimiser: nelder_mead, max_passes: 9, parameter_tolerance: 0.1, objective_tolerance: 0.2,
      lambda_span: 10}
    iterate: {method: alg3, max_passes: 8, parameter_tolerance: 0.3, zero_tolerance: 0.4}
report: {title: "Ä title", formats: [svg, md], published: there.yaml}
"""

IMPORTED = """
experiment: imported
model: {file: my/robot.py, class: Robot}
import:
  recordings:
    a:
      file: a.csv
      rows: [10, 200]
      time: {interval: 0.01, offset: 3}
      inputs: {u: {column: 4, scale: -2, offset: 0.5}}
      outputs: {y: 5}
    b: {file: b.csv}
  group: separate
  format: {kind: csv, delimiter: ";", header: false, comment: "%", decimal: ","}
  time: {column: 1, scale: 1e-3, offset: -2}
  inputs: {u: torque, w: {column: w}}
  outputs: {y: {column: 3}}
  on_problem:
    non_number: mark missing
    repeated_stamp: mark-missing
    backward_stamp: drop
    gap: split
    unequal_interval: resample
  gap_factor: 5
  interval_tolerance: 0.1
  nominal_interval: 0.01
estimate:
  process_noise: {known: {std: [1]}}
  measurement_noise: {known: {std: [1]}}
  initial_mean: {known: {a: [0, 0], b: [1, 0]}}
  initial_covariance: {start: {std: [1, 1]}}
"""


def read(tmp_path, text):
    file = tmp_path / "e.yaml"
    file.write_text(text)
    return load_experiment(file)


def test_every_option_of_a_simulation(tmp_path):
    got = read(tmp_path, SIMULATED).experiment
    assert (got.experiment, got.seed, got.model.discretisation) == ("all.options_1", 1234567890123456789, "rk4")
    assert got.model.parameters == {"g": 9.8, "m": 1.0}
    simulate = got.simulate
    assert (simulate.samples, simulate.sample_time, simulate.tests, simulate.replicates) == (200, 1e-3, 3, 4)
    assert type(simulate.samples) is int
    motion = simulate.trajectory
    assert (motion.amplitude, motion.lowest, motion.highest, motion.lines) == ((1.0, 0.0), 0.1, 20.0, 7)
    assert simulate.initial_state == (0.1, -0.2)
    changes = [(change.at, change.set, change.scale) for change in simulate.parameter_changes]
    assert changes == [(0.1, {"g": 2.0}, {}), (0.15, {}, {"m": 3.0, "g": 4.0})]
    assert (simulate.held_out.tests, simulate.held_out.trajectory.hold) == (2, 0.5)
    estimate = got.estimate
    assert estimate.process_noise.structure.blocks == (("a",), ("b",))
    assert estimate.process_noise.fixed == ("a", ("a", "b"))
    assert estimate.measurement_noise.structure == "scale"
    assert estimate.initial_mean.start == (0.0, 1.0)
    assert (estimate.initial_covariance.structure, estimate.initial_covariance.fixed) == ("diagonal", ("x",))
    assert (estimate.starts.scale, estimate.starts.measurement_scale) == ((0.1, 1.0, 10.0), (1.0, 2.0, 3.0))
    assert list(estimate.methods) == ["em", "slow", "path", "iterate"]
    assert estimate.methods["slow"].model_dump() == {
        "method": "em",
        "structure": "diagonal",
        "smoother": "extended",
        "alpha": 1.0,
        "beta": 2.0,
        "kappa": None,
        "linearisation": "filtered",
        "acceleration": "none",
        "max_passes": 7,
        "loglik_tolerance": 0.0,
        "parameter_tolerance": 1e-6,
        "stop": "loglik",
        "fall_tolerance": 0.5,
    }
    assert estimate.methods["path"].model_dump() == {
        "method": "alg2",
        "structure": None,
        "optimiser": "nelder_mead",
        "max_passes": 9,
        "parameter_tolerance": 0.1,
        "objective_tolerance": 0.2,
        "lambda_span": 10.0,
    }
    assert estimate.methods["iterate"].model_dump() == {
        "method": "alg3",
        "structure": None,
        "max_passes": 8,
        "parameter_tolerance": 0.3,
        "zero_tolerance": 0.4,
    }
    assert (got.report.title, got.report.formats) == ("Ä title", ("svg", "md"))
    assert got.report.published == "there.yaml"


DRAWN = """
experiment: drawn
model: {name: robot}
simulate:
  samples: 10
  trajectory: {kind: zero}
  process_noise: {std: [1]}
  measurement_noise: {std: [1]}
estimate:
  process_noise: {start: {std: [1]}}
  measurement_noise: {known: {std: [1]}}
  initial_mean: {known: truth}
  initial_covariance: {known: {std: [1]}}
  starts: STARTS
"""


@pytest.mark.parametrize(
    ("starts", "factors"),
    [
        ("{draw: {count: 4, factors: {kind: log_uniform, lowest: 0.1, highest: 5}}}", {"lowest": 0.1, "highest": 5.0}),
        ("{draw: {count: 4, factors: {kind: log_normal, spread: 3}}}", {"spread": 3.0}),
    ],
)
def test_drawn_starts(tmp_path, starts, factors):
    draw = read(tmp_path, DRAWN.replace("STARTS", starts)).experiment.estimate.starts.draw
    assert draw.count == 4
    assert draw.factors.model_dump(exclude={"kind"}) == factors


@pytest.mark.parametrize(
    ("starts", "text"),
    [
        ("{draw: {count: 0, factors: {kind: log_normal, spread: 3}}}", "count"),
        ("{draw: {count: 1, factors: {kind: log_normal, spread: 1}}}", "spread"),
        ("{draw: {count: 1, factors: {kind: log_uniform, lowest: 2, highest: 1}}}", "must be above lowest"),
        ("{scale: [2], draw: {count: 1, factors: {kind: log_normal, spread: 2}}}", "takes the place of scale"),
    ],
)
def test_drawn_starts_that_make_no_sense(tmp_path, starts, text):
    with pytest.raises(ConfigError, match=text):
        read(tmp_path, DRAWN.replace("STARTS", starts))


def test_every_option_of_an_import(tmp_path):
    got = read(tmp_path, IMPORTED).experiment
    assert (got.model.file, got.model.class_name, got.seed) == ("my/robot.py", "Robot", 0)
    section = got.import_
    assert (section.group, section.gap_factor, section.interval_tolerance) == ("separate", 5.0, 0.1)
    assert section.nominal_interval == 0.01
    assert section.format.model_dump() == {
        "kind": "csv",
        "delimiter": ";",
        "header": False,
        "comment": "%",
        "decimal": ",",
        "group": None,
    }
    assert section.on_problem.model_dump() == {
        "non_number": "mark_missing",
        "repeated_stamp": "mark_missing",
        "backward_stamp": "drop",
        "gap": "split",
        "unequal_interval": "resample",
    }
    first, second = section.source("a"), section.source("b")
    assert first.rows == (10, 200)
    assert (first.time.interval, first.time.offset, first.time.column) == (0.01, 3.0, None)
    assert (second.time.column, second.time.scale, second.time.offset) == (1, 1e-3, -2.0)
    assert (first.inputs["u"].column, first.inputs["u"].scale, first.inputs["u"].offset) == (4, -2.0, 0.5)
    assert (second.inputs["u"].column, second.inputs["u"].scale) == ("torque", 1.0)
    assert first.inputs["w"] == second.inputs["w"]
    assert (first.outputs["y"].column, second.outputs["y"].column) == (5, 3)
    assert got.estimate.initial_mean.known == {"a": (0.0, 0.0), "b": (1.0, 0.0)}


@pytest.mark.parametrize("kind", ["mat", "hdf5"])
def test_groups_of_binary_files(tmp_path, kind):
    text = IMPORTED.replace('{kind: csv, delimiter: ";", header: false, comment: "%", decimal: ","}', "")
    got = read(tmp_path, text.replace("format:", f"format: {{kind: {kind}, group: log/one}}"))
    assert got.experiment.import_.format.group == "log/one"


@pytest.mark.parametrize(
    ("motion", "kind"),
    [
        ("{kind: zero}", "zero"),
        ("{kind: steps, amplitude: [1, 2], hold: 0.5}", "steps"),
        (
            "{kind: s_curve, input: a, output: b, between: [1, -1], start: 0, move_time: 1, dwell: 0, "
            "hold: {begin: 3, end: 5}, position_gain: 1, speed_gain: 2, cutoff: 3}",
            "s_curve",
        ),
    ],
)
def test_other_motions(tmp_path, motion, kind):
    start = SIMULATED.index("{kind: multisine")
    text = SIMULATED[:start] + motion + SIMULATED[SIMULATED.index("\n", start) :]
    assert read(tmp_path, text).experiment.simulate.trajectory.kind == kind


WRONG = [
    ("rows: [10, 200]", "rows: [0, 200]", "1 <= first < last, not 0 and 200"),
    ("rows: [10, 200]", "rows: [5, 5]", "1 <= first < last"),
    ("column: 4", "column: 0", "numbered from 1, not 0"),
    ("column: 4", "column: true", "name of a column"),
    ("column: 4", "column: 1.5", "name of a column"),
    ("y: 5", "y: true", "must be a mapping"),
    ("y: 5", "y: ''", "name of a column"),
    ("scale: -2", "scale: 0", "erase the column"),
    ("time: {interval: 0.01, offset: 3}", "time: {interval: 0.01, scale: 3}", "scale goes with column"),
    ("time: {interval: 0.01, offset: 3}", "time: {interval: 0.01, column: 3}", "either column or interval"),
    ("time: {interval: 0.01, offset: 3}", "time: {offset: 1}", "either column or interval"),
    ("time: {column: 1, scale: 1e-3, offset: -2}", "", "has no time"),
    ('delimiter: ";"', 'delimiter: ","', "decimal sign already"),
    ('delimiter: ";"', 'delimiter: ";;"', "at most 1 characters"),
    ("kind: csv", "kind: mat", "goes with kind csv, not mat"),
    ("kind: csv", "kind: csv, group: x", "mat or hdf5, not csv"),
    ("b: {file: b.csv}", "A: {file: b.csv}", "upper and lower case"),
    ("gap: split", "gap: ignore", "error, mark_missing, split"),
    ("backward_stamp: drop", "backward_stamp: mark_missing", "error, drop"),
    ("gap_factor: 5", "gap_factor: 1", "greater than 1, not 1"),
    ("interval_tolerance: 0.1", "interval_tolerance: -0.1", "at least 0"),
    ("nominal_interval: 0.01", "nominal_interval: 0", "greater than 0"),
    ("{known: {a: [0, 0], b: [1, 0]}}", "{known: {}}", "at least 1 entry"),
    ("{known: {a: [0, 0], b: [1, 0]}}", "{known: {a: [0, x]}}", "must be a number"),
]


@pytest.mark.parametrize(("old", "new", "said"), WRONG)
def test_wrong_imports(tmp_path, old, new, said):
    assert old in IMPORTED
    with pytest.raises(Exception, match=said) as caught:
        read(tmp_path, IMPORTED.replace(old, new, 1))
    assert len(caught.value.problems) == 1


@pytest.mark.parametrize(
    ("new", "said"),
    [
        ("lowest: 30", "must be at least lowest, 30 Hz"),
        ("lowest: 20", "7 lines need"),
        ("lowest: 0", "greater than 0"),
    ],
)
def test_wrong_frequencies(tmp_path, new, said):
    with pytest.raises(Exception, match=said):
        read(tmp_path, SIMULATED.replace("lowest: 0.1", new))


def test_what_is_loaded_cannot_be_changed(tmp_path):
    experiment = read(tmp_path, SIMULATED).experiment
    with pytest.raises(ValidationError, match="frozen"):
        experiment.seed = 3


def test_every_setting_is_described(tmp_path):
    for options in METHOD_OPTIONS.values():
        assert issubclass(options, MethodOptions)
        assert all(field.description for field in options.model_fields.values())


# Covariances


def test_forms_of_a_covariance():
    S = [[4.0, 1.0], [1.0, 9.0]]
    same = [
        Covariance(std=[2, 3], correlation=[[1, 1 / 6], [1 / 6, 1]]),
        Covariance(full=S),
    ]
    for covariance in same:
        np.testing.assert_allclose(covariance.matrix(), S, rtol=1e-15)
        assert covariance.size == 2
    assert np.array_equal(Covariance(diag=[4, 9]).matrix(), np.diag([4.0, 9.0]))
    assert np.array_equal(Covariance(std=[2, 3]).matrix(), np.diag([4.0, 9.0]))
    assert [Covariance(diag=[1]).form, Covariance(std=[1]).form, same[1].form] == ["diag", "std", "full"]


@given(st.lists(st.floats(1e-150, 1e150), min_size=2, max_size=4), st.floats(-1, 1))
@settings(max_examples=100)
def test_std_and_correlation_make_an_exactly_symmetric_matrix(std, rho):
    n = len(std)
    correlation = np.eye(n)
    correlation[0, 1] = correlation[1, 0] = rho
    matrix = Covariance(std=std, correlation=correlation.tolist()).matrix()
    assert np.array_equal(matrix, matrix.T)
    assert np.array_equal(np.diag(matrix), np.square(std))


@pytest.mark.parametrize("n", [1, 2, 5, 8])
@pytest.mark.parametrize("seed", range(5))
def test_singular_covariances_of_any_scale_pass(n, seed):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, max(1, n - 1))) * 10.0 ** rng.integers(-8, 9, size=(n, 1))
    S = A @ A.T
    S = np.tril(S) + np.tril(S, -1).T
    assert np.array_equal(Covariance(full=S.tolist()).matrix(), S)


@pytest.mark.parametrize("scale", [1.0, 1e-12, 1e12])
def test_an_indefinite_matrix_is_refused_at_any_scale(scale):
    d = np.array([1.0, scale, 1.0])
    S = np.array([[1.0, 0.9, 0.0], [0.9, 1.0, 0.9], [0.0, 0.9, 1.0]]) * d * d[:, None]
    # Eigenvalues of the unscaled matrix: 1 and 1 +- 0.9 sqrt 2; the lowest belongs to (1, -sqrt 2, 1) / 2.
    with pytest.raises(ValidationError, match=r"eigenvalue is -0.273, in the direction \((-0.5, 0.707, -0.5)\)"):
        Covariance(full=S.tolist())
    value, direction = smallest_eigenvalue(S)
    assert value == pytest.approx(1 - 0.9 * np.sqrt(2), rel=1e-12)
    np.testing.assert_allclose(direction, [-0.5, np.sqrt(0.5), -0.5], rtol=1e-12)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({}, "none of them is here"),
        ({"std": [1], "full": [[1]]}, "here are std and full"),
        ({"std": [-1]}, "greater than or equal to 0"),
        ({"diag": [-1]}, "greater than or equal to 0"),
        ({"diag": [1], "correlation": [[1]]}, "goes with std"),
        ({"std": [1, 1], "correlation": [[1]]}, "has 1 rows, but must have 2"),
        ({"std": [1, 1], "correlation": [[1, 2], [2, 1]]}, "eigenvalue is -1"),
        ({"std": [1, 1], "correlation": [[2, 0], [0, 1]]}, "1 on its diagonal, not 2"),
        ({"full": [[1, 0], [0]]}, "row 2 has 1 numbers, but must have 2"),
        ({"full": [[1, 0.1], [0.2, 1]]}, r"entry \(2, 1\) is 0.2, entry \(1, 2\) is 0.1"),
        ({"full": [[-1, 0], [0, 1]]}, "variance 1 is negative: -1"),
        ({"full": [[1, 1], [1, 0]]}, "variance 2 is 0, so row 2 must be 0"),
    ],
)
def test_wrong_covariances(given, said):
    with pytest.raises(ValidationError, match=said):
        Covariance.model_validate(given)
