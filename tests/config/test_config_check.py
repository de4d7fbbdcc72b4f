from dataclasses import replace

import pytest

from noiseid_cli.config.check import check_against
from noiseid_cli.config.findings import ModelNames
from noiseid_cli.config.load import builtin_experiment, load_experiment

ROBOT = ModelNames(
    states=("qa1", "qa2", "qm1", "qm2", "dqa1", "dqa2", "dqm1", "dqm2"),
    inputs=("u1", "u2"),
    noises=("va1", "va2", "vm1", "vm2"),
    outputs=("qm1", "qm2", "as", "an"),
    parameters=("g", "j1"),
    sample_time=5e-4,
    discretisation="euler",
)
PENDULUM = ModelNames(
    states=("q1", "q2", "w1", "w2"), inputs=("tau1", "tau2"), noises=("v1", "v2"), outputs=("q1", "q2")
)
JOINT = (
    "{kind: s_curve, input: u1, output: qm1, between: [0, 1], start: 0.5, move_time: 1, dwell: 0.1, "
    "hold: {begin: 1.05, end: 2}, position_gain: 15, speed_gain: 2, cutoff: 60}"
)
MEASURED = "configs/double_pendulum_measured.yaml"
COUPLED = "{full: [[2,1,0,0],[1,2,0,0],[0,0,1,0],[0,0,0,1]]}"
EIGHT = "[1, 1, 1, 1, 1, 1, 1, 1]"


def simulated(*overrides, model=ROBOT):
    return check_against(load_experiment(builtin_experiment(), overrides), model)


def measured(*overrides, model=PENDULUM):
    return check_against(load_experiment(MEASURED, overrides), model)


def test_the_shipped_experiments_fit_their_models():
    assert simulated() == []
    assert measured() == []


FITS = [
    ["model.parameters={g: 9.8}", "model.discretisation=rk4"],
    ["simulate.tests=2", f"estimate.initial_covariance={{start: {{std: {EIGHT}}}}}"],
    ["simulate.trajectory={kind: multisine, amplitude: [1, 1], lowest: 1, highest: 999, lines: 3}"],
    ["simulate.trajectory={kind: steps, amplitude: [1, 1], hold: 1}", f"simulate.initial_state={EIGHT}"],
    ["estimate.process_noise={start: {std: [2, 1, 1, 1]}, fixed: [va1]}", "estimate.initial_mean={start: truth}"],
    [f"estimate.process_noise={{start: {COUPLED}, structure: {{blocks: [[va2, va1]]}}}}"],
    ["estimate.measurement_noise={start: {std: [1,1,1,1]}}", "estimate.starts.measurement_scale=[1, 2]"],
    ["estimate.initial_covariance={known: {std: [0, 0, 0, 0, 0, 0, 0, 0]}}"],
    [f"estimate.initial_mean={{start: {EIGHT}}}"],
    ["simulate.samples=16777216"],
    [f"simulate.trajectory={JOINT}"],
    ["simulate.parameter_changes=[{at: 1, set: {g: 2}}, {at: 0.5, scale: {g: 2, j1: 3}}]"],
]  # fmt: skip


@pytest.mark.parametrize("overrides", FITS)
def test_what_fits(overrides):
    assert simulated(*overrides) == []


SIMULATED = [
    ("model.parameters={G: 1}", "model.parameters.G", "parameters: g, j1; did you mean g?"),
    ("model.discretisation=discrete", "model.discretisation", "only euler, rk4 or exact fits"),
    ("simulate.process_noise.std=[1, 2]", "simulate.process_noise.std", "but the model has 4 process noises"),
    ("simulate.measurement_noise={full: [[1]]}", "simulate.measurement_noise.full", "4 outputs: qm1, qm2, as, an"),
    ("simulate.initial_state=[1]", "simulate.initial_state", "1 number, but the model has 8 states"),
    ("simulate.sample_time=1", "simulate.trajectory.side_time", "0.5 s must be at least the sample time, 1 s"),
    ("simulate.trajectory={kind: steps, amplitude: [1], hold: 1}", "simulate.trajectory.amplitude", "2 inputs: u1, u2"),
    ("simulate.trajectory={kind: steps, amplitude: [1, 1], hold: 1e-4}", "simulate.trajectory.hold", "sample time"),
    ("simulate.trajectory={kind: multisine, amplitude: [1, 1], lowest: 1, highest: 1000, lines: 3}",
     "simulate.trajectory.highest", "below half the sampling frequency, 1000 Hz"),
    (f"simulate.trajectory={JOINT.replace('u1', 'u')}", "simulate.trajectory.input",
     "u is not one of the model's inputs"),
    (f"simulate.trajectory={JOINT.replace('qm1', 'an2')}", "simulate.trajectory.output", "did you mean an?"),
    (f"simulate.trajectory={JOINT.replace('60', '1000')}", "simulate.trajectory.cutoff", "below half the sampling"),
    (f"simulate.trajectory={JOINT.replace('move_time: 1', 'move_time: 1e-4').replace('1.05', '0.1')}",
     "simulate.trajectory.move_time", "at least the sample time"),
    ("simulate.parameter_changes=[{at: 1, scale: {j1: 2, j2: 2}}]", "simulate.parameter_changes.0.scale.j2",
     "j2 is not one of the model's parameters: g, j1"),
    ("simulate.parameter_changes=[{at: 1, set: {j1: 2}}, {at: 2.1, set: {j1: 2}}]", "simulate.parameter_changes.1.at",
     "2.1 s is after the last sample, at 1.9995 s"),
    ("model.name=one_link", "simulate.trajectory.kind", "flexible_robot only"),
    ("estimate.process_noise={start: {std: [1]}}", "estimate.process_noise.start.std", "1 entry"),
    ("estimate.process_noise={start: {std: [1,1,1,1]}, structure: {blocks: [[va1, vb]]}}",
     "estimate.process_noise.structure.blocks.0.1", "vb is not one of the model's process noises"),
    ("estimate.process_noise={start: {std: [1,1,1,1]}, fixed: [va1, [va1, va22]]}",
     "estimate.process_noise.fixed.1.1", "did you mean va2?"),
    ("estimate.process_noise={start: {std: [1,1,1,1]}, fixed: [qm1]}", "estimate.process_noise.fixed.0", "qm1"),
    ("estimate.process_noise.start.std=[1, 0, 1, 1]", "estimate.process_noise.start.std.1", "va2 must not be 0"),
    ("estimate.process_noise={start: {std: [0, 1, 1, 1]}, fixed: [va1]}",
     "estimate.process_noise.start.std.0", "must not be 0"),
    ("estimate.process_noise={start: {full: [[1,1,0,0],[1,1,0,0],[0,0,1,0],[0,0,0,1]]}}",
     "estimate.process_noise.start.full", "singular in the direction"),
    (f"estimate.process_noise={{start: {COUPLED}, structure: diagonal}}",
     "estimate.process_noise.start.full", "covariance of va1 and va2"),
    (f"estimate.process_noise={{start: {COUPLED}, structure: {{blocks: [[va1], [va2, vm1]]}}}}",
     "estimate.process_noise.start.full", "covariance of va1 and va2"),
    ("estimate.measurement_noise={known: {full: [[0,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}}",
     "estimate.measurement_noise.known.full.0.0", "qm1 must not be 0"),
    ("estimate.initial_mean={known: [1, 2]}", "estimate.initial_mean.known", "8 states"),
    ("estimate.initial_mean={known: {a: [1]}}", "estimate.initial_mean.known", "goes with import"),
    (f"estimate.initial_covariance={{start: {{std: {EIGHT}}}}}", "estimate.initial_covariance.start", "at least two"),
    ("estimate.starts.measurement_scale=[1, 2]", "estimate.starts.measurement_scale", "which is known here"),
]  # fmt: skip


SAMPLED = replace(ROBOT, parameters=("g", "Ts"), sample_time_parameter="Ts")


def test_a_sample_time_in_two_places_must_agree():
    same = ["model.parameters={Ts: 1e-3}", "simulate.sample_time=1e-3"]
    assert simulated(*same, model=SAMPLED) == []
    assert simulated(same[0], model=SAMPLED) == []
    (problem,) = simulated(same[0], "simulate.sample_time=2e-3", model=SAMPLED)
    assert problem.path == "model.parameters.Ts"
    assert "simulate.sample_time gives as 0.002 s: leave one out" in problem.message


def test_the_sample_time_does_not_change_during_a_test():
    (problem,) = simulated("simulate.parameter_changes=[{at: 1, set: {Ts: 1}}]", model=SAMPLED)
    assert problem.path == "simulate.parameter_changes.0.set.Ts"
    assert "cannot change during a test" in problem.message


@pytest.mark.parametrize(("override", "path", "said"), SIMULATED)
def test_what_does_not_fit_a_simulation(override, path, said):
    problems = simulated(override)
    assert [p.path for p in problems] == [path]
    assert said in problems[0].message


def test_nothing_to_estimate():
    paths = [p.path for p in simulated("estimate.process_noise={known: {std: [1, 1, 1, 1]}}")]
    assert paths == ["estimate", "estimate.starts.scale"]


def test_a_discrete_model_takes_no_integration_rule():
    model = ModelNames(**{**vars(ROBOT), "discretisation": "discrete"})
    assert "only discrete fits" in simulated("model.discretisation=euler", model=model)[0].message
    assert simulated("model.discretisation=discrete", model=model) == []


def test_a_model_without_sample_time_needs_one():
    model = ModelNames(**{**vars(ROBOT), "sample_time": None})
    assert [p.path for p in simulated(model=model)] == ["simulate.sample_time"]
    assert simulated("simulate.sample_time=1e-3", model=model) == []


IMPORTED = [
    ("import.inputs.tau3=x", "import.inputs.tau3", "did you mean tau"),
    ("import.outputs={q1: a}", "import.outputs", "q2 is missing: which column is it?"),
    ("import.recordings.excited.outputs={p1: a}", "import.recordings.excited.outputs.p1", "q1, q2"),
    ("estimate.initial_mean={known: truth}", "estimate.initial_mean.known", "simulated tests only"),
    ("estimate.initial_mean={known: {excited: [0, 0, 0, 0]}}", "estimate.initial_mean.known", "no list for swing_up"),
    ("estimate.initial_mean={start: {excited: [0, 0, 0, 0], swing_up: [0, 0, 0, 0], swingup: [0, 0, 0, 0]}}",
     "estimate.initial_mean.start.swingup", "did you mean swing_up?"),
    ("estimate.initial_mean={start: {excited: [0, 0, 0], swing_up: [0, 0, 0, 0]}}",
     "estimate.initial_mean.start.excited", "3 numbers, but the model has 4"),
    ("estimate.initial_covariance={start: {std: [1, 1, 1, 1]}}", "estimate.initial_covariance.start", "two tests"),
]  # fmt: skip


@pytest.mark.parametrize(("override", "path", "said"), IMPORTED)
def test_what_does_not_fit_an_import(override, path, said):
    problems = measured(override)
    assert [p.path for p in problems] == [path]
    assert said in problems[0].message


def test_a_channel_may_be_mapped_in_each_recording_instead():
    half = ["import.inputs={tau1: tau_meas1}", "import.recordings.excited.inputs={tau2: tau_meas2}"]
    assert [p.path for p in measured(*half)] == ["import.recordings.swing_up.inputs"]
    assert measured(*half, "import.recordings.swing_up.inputs={tau2: 7}") == []


@pytest.mark.parametrize("grouping", ["import.group=together", "import.on_problem.gap=split"])
def test_several_recordings_show_the_spread_of_the_start(grouping):
    assert measured("estimate.initial_covariance={start: {std: [1, 1, 1, 1]}}", grouping) == []


def test_problems_point_into_the_file():
    (problem,) = measured(model=ModelNames(**{**vars(PENDULUM), "noises": ("v1", "v2", "v3")}))
    line = problem.excerpt
    assert line.strip().startswith("start: {std: [1, 1]}")
    assert line[problem.column - 1 :].startswith("[1, 1]")


def test_the_exact_scheme_is_for_linear_models():
    model = ModelNames(**{**vars(ROBOT), "nonlinearity": "the rate of dqa1 is not linear: why"})
    (problem,) = simulated("model.discretisation=exact", model=model)
    assert problem.path == "model.discretisation"
    assert (
        problem.message == "exact is for linear dynamics only; the rate of dqa1 is not linear: why: take rk4 or euler"
    )
    assert simulated("model.discretisation=exact") == []


ADAPTIVE = (
    "estimate.parameters={j1: {start: 1}}",
    "estimate.process_noise={start: {std: [2, 1, 1, 1]}, structure: diagonal, fixed: [va2, vm1, vm2]}",
)
HERE = "estimate.methods.x"


@pytest.mark.parametrize(
    ("options", "place", "words"),
    [
        ("method: asrukf, parameter_covariance: {va1: 1}", f"{HERE}.parameter_covariance", "no entry for j1"),
        (
            "method: asrukf, parameter_covariance: {va1: 1, j1: 1, va2: 1}",
            f"{HERE}.parameter_covariance.va2",
            "va2 is not estimated here; what this table may name: va1, j1",
        ),
        (
            "method: sb-asrukf, parameter_covariance: {va1: 1, j1: 1}, thresholds: {va1: 0.1}",
            f"{HERE}.thresholds.va1",
            "may name: j1",
        ),
        (
            "method: joint-srukf, parameter_covariance: {j1: 1}, parameter_noise: {j: 1}",
            f"{HERE}.parameter_noise",
            "no entry for j1",
        ),
        (
            "method: joint-srukf, parameter_covariance: {j1: 1}, parameter_noise: {j1: 1}",
            HERE,
            "joint-srukf cannot estimate what estimate.process_noise asks for",
        ),
        (
            "method: asrukf, structure: full, parameter_covariance: {va1: 1, j1: 1}",
            HERE,
            "takes a process noise of structure diagonal, fixed, not full",
        ),
    ],
)
def test_tables_of_the_online_filters(options, place, words):
    problems = simulated(*ADAPTIVE, f"estimate.methods={{x: {{{options}}}}}")
    found = {".".join(map(str, p.path)) if not isinstance(p.path, str) else p.path: p.message for p in problems}
    assert words in found[place]


def test_complete_tables_of_the_online_filters_fit():
    both = "parameter_covariance: {va1: 1, j1: 1}"
    joint = "parameter_covariance: {j1: 1}, parameter_noise: {j1: 0}, hold_process_noise: true"
    methods = f"{{asrukf: {{{both}}}, sb-asrukf: {{{both}, thresholds: {{j1: 0.1}}}}, joint-srukf: {{{joint}}}}}"
    assert simulated(*ADAPTIVE, f"estimate.methods={methods}") == []
