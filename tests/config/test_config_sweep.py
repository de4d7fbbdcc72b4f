"""The `sweep` section: which points there are, what is drawn for them, and complaints at the right place."""

import json
import math

import pytest

from noiseid_cli.config.load import load_experiment
from noiseid_cli.config.sweep import load_point, sweep_points
from noiseid_cli.errors import ConfigError

BASE = """\
experiment: swept
seed: 7
model: {name: flexible_robot}
simulate:
  samples: 80
  trajectory: {kind: zero}
  process_noise: {std: [1, 1, 1, 1]}
  measurement_noise: {std: [1, 1, 1, 1]}
sweep:
"""


@pytest.fixture
def swept(tmp_path):
    def load(sweep, *overrides):
        file = tmp_path / "swept.yaml"
        file.write_text(BASE + "".join(f"  {line}\n" for line in sweep.splitlines()))
        return load_experiment(file, overrides)

    return load


def refused(swept, sweep):
    with pytest.raises(ConfigError) as error:
        swept(sweep)
    (problem,) = error.value.problems
    return problem


TWO = """\
axes:
  samples: {vary: simulate.samples, values: [80, 200, 500]}
  noise: {vary: simulate.process_noise.std.1, values: [1, 0.5]}
"""


def test_a_product_takes_every_pair_the_last_axis_first(swept):
    loaded = swept(TWO)
    points = sweep_points(loaded)
    assert [tuple(p.values.values()) for p in points] == [(n, q) for n in (80, 200, 500) for q in (1, 0.5)]
    assert [p.name for p in points][:2] == ["point-000", "point-001"]
    assert len(points) == loaded.experiment.sweep.points == 6
    at = load_point(loaded, points[3]).experiment
    assert (at.simulate.samples, at.simulate.process_noise.std) == (200, (1, 0.5, 1, 1))
    assert at.sweep is None
    assert loaded.experiment.simulate.samples == 80  # the experiment itself is as it was


def test_a_zip_takes_first_with_first(swept):
    loaded = swept(TWO.replace("[1, 0.5]", "[1, 2, 3]") + "combine: zip\n")
    assert [tuple(p.values.values()) for p in sweep_points(loaded)] == [(80, 1), (200, 2), (500, 3)]
    assert loaded.experiment.sweep.points == 3
    problem = refused(swept, TWO + "combine: zip\n")
    assert problem.message == "has 2 values, but samples has 3: zip needs as many of each"
    assert problem.path == "sweep.axes.noise"


def test_without_a_sweep_there_are_no_points(tmp_path):
    file = tmp_path / "plain.yaml"
    file.write_text(BASE.removesuffix("sweep:\n"))
    assert sweep_points(load_experiment(file)) == []


def test_one_axis_can_set_several_settings_and_whole_sections(swept):
    loaded = swept(
        "axes:\n"
        "  both: {vary: [simulate.process_noise.std.0, simulate.measurement_noise.std.0], values: [3]}\n"
        "  motion: {vary: simulate.trajectory, values: [{kind: steps, amplitude: [1, 1], hold: 2}]}"
    )
    at = load_point(loaded, sweep_points(loaded)[0]).experiment.simulate
    assert at.process_noise.std[0] == at.measurement_noise.std[0] == 3
    assert at.trajectory.kind == "steps"


def draws(swept, kind, count=400, seed=7, path="simulate.process_noise.std.0"):
    loaded = swept(f"axes:\n  q: {{vary: {path}, draw: {kind}, count: {count}}}", f"seed={seed}")
    return [p.values["q"] for p in sweep_points(loaded)]


@pytest.mark.parametrize(
    ("kind", "median", "inside"),
    [
        ("{kind: uniform, lowest: 2, highest: 4}", 3.0, lambda v: 2 <= v <= 4),
        ("{kind: log_uniform, lowest: 1, highest: 100}", 10.0, lambda v: 1 <= v <= 100),
        ("{kind: normal, mean: 5, std: 0.5}", 5.0, lambda v: abs(v - 5) < 3),
        ("{kind: log_normal, median: 5, spread: 2}", 5.0, lambda v: 5 / 2**6 < v < 5 * 2**6),
    ],
)
def test_drawn_values_have_their_distribution(swept, kind, median, inside):
    values = draws(swept, kind)
    assert all(inside(v) for v in values)
    # The number of values above the median is binomial: 400 draws, standard deviation 10.
    assert abs(sum(v > median for v in values) - 200) < 50
    assert len(set(values)) == 400


def test_the_spread_of_a_normal_is_its_own(swept):
    values = [math.log(v / 5) / math.log(2) for v in draws(swept, "{kind: log_normal, median: 5, spread: 2}")]
    # The sum of squares is chi-squared with 400 degrees of freedom: standard deviation sqrt(800).
    assert abs(sum(v * v for v in values) - 400) < 5 * math.sqrt(800)


def test_a_drawn_value_depends_on_seed_setting_and_number_only(swept):
    kind = "{kind: uniform, lowest: 2, highest: 4}"
    values = draws(swept, kind, 5)
    assert draws(swept, kind, 8)[:5] == values
    assert draws(swept, kind, 5, seed=8) != values
    assert draws(swept, kind, 5, path="simulate.process_noise.std.1") != values


@pytest.mark.parametrize(
    ("axis", "path", "message"),
    [
        ("{vary: simulate.samples}", "sweep.axes.a", "give either values or draw"),
        ("{vary: simulate.samples, values: [1], count: 3}", "sweep.axes.a", "draw and count go together"),
        ("{vary: seed, values: [1, 2, 1]}", "sweep.axes.a.values.2", "is in the list already, as entry 0"),
        ("{vary: seed, values: []}", "sweep.axes.a.values", "must have at least 1 entry"),
        ("{vary: report.title, values: [a]}", "sweep.axes.a.vary", "report cannot be varied"),
        ("{vary: experiment, values: [a]}", "sweep.axes.a.vary", "experiment cannot be varied"),
        ("{vary: a..b, values: [1]}", "sweep.axes.a.vary", "is not a path of settings"),
        ("{vary: [seed, seed], values: [1]}", "sweep.axes.a.vary.1", "is varied by a already"),
        ("{vary: [simulate, simulate.samples], values: [1]}", "sweep.axes.a.vary.1", "in whole or in part"),
        ("{vary: seed, draw: {kind: uniform, lowest: 2, highest: 1}, count: 2}", "highest", "must be above lowest"),
        ("{vary: seed, draw: {kind: cauchy}, count: 2}", "sweep.axes.a.draw.kind", "uniform, log_uniform, normal"),
        ("{vary: seed, draw: {kind: uniform, lowest: 1, highest: 2}, count: 200000}", "sweep.axes", "200000 points"),
    ],
)
def test_what_is_wrong_with_an_axis_is_told_at_its_place(swept, axis, path, message):
    problem = refused(swept, f"axes:\n  a: {axis}")
    assert problem.path.endswith(path)
    assert message in problem.message


def test_two_axes_cannot_vary_one_setting_or_share_a_name(swept):
    both = "axes:\n  a: {vary: seed, values: [1]}\n  b: {vary: seed, values: [2]}"
    assert "is varied by a already" in refused(swept, both).message
    twins = "axes:\n  a: {vary: seed, values: [1]}\n  A: {vary: simulate.samples, values: [20]}"
    assert "upper and lower case" in refused(swept, twins).message


@pytest.mark.parametrize(
    ("axis", "line", "message"),
    [
        ("{vary: simulate.samples, values: [80, 1]}", 11, "must be at least 2, not 1"),
        ("{vary: simulate.sample, values: [80]}", 11, "did you mean samples?"),
        ("{vary: simulate.process_noise.std.9, values: [80]}", 11, "9 must be 0 to 3"),
        ("{vary: seed.a, values: [80]}", 11, "holds a single value"),
    ],
)
def test_a_value_that_does_not_fit_is_told_where_it_stands(swept, axis, line, message):
    loaded = swept(f"axes:\n  a: {axis}")
    with pytest.raises(ConfigError) as error:
        load_point(loaded, sweep_points(loaded)[-1])
    problem = error.value.problems[0]
    assert message in problem.message
    assert problem.line == line


def test_values_from_the_command_line_are_told_as_theirs(swept):
    loaded = swept(TWO, "sweep.axes.samples.values=[1]")
    with pytest.raises(ConfigError) as error:
        load_point(loaded, sweep_points(loaded)[0])
    assert error.value.problems[0].source == "--set sweep.axes.samples.values=[1]"


def test_a_sweep_is_part_of_the_settings_and_a_point_is_not(swept):
    loaded = swept(TWO)
    assert json.loads(json.dumps(loaded.resolved()))["sweep"]["axes"]["samples"]["values"] == [80, 200, 500]
    assert "sweep" not in load_point(loaded, sweep_points(loaded)[0]).resolved()
