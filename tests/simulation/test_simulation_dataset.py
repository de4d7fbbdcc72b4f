"""Simulated datasets: streams, statistics, open-loop motions, and faults."""

import time
from pathlib import Path

import numpy as np
import pytest
from one_step import transition, workspace

from noiseid_cli.errors import DataError, ModelError
from noiseid_cli.models import Model, Quantity
from noiseid_cli.models.compile import compile_model
from noiseid_cli.models.registry import load_model, load_model_file
from noiseid_cli.simulation import signals
from noiseid_cli.simulation.motions import MOTIONS, Multisine, Plan, Square, Steps, Zero, plan_motion
from noiseid_cli.simulation.rollout import rollout
from noiseid_cli.simulation.simulate import covariance_factor, simulate

CONFIGS = Path(__file__).parents[2] / "configs"
Q_ROBOT = np.diag([50.0, 20.0, 30.0, 15.0]) ** 2
R_ROBOT = np.diag([1e-12, 1e-12, 1e-3, 1e-3])


@pytest.fixture(scope="module")
def robot():
    model = load_model("flexible_robot")
    return model, compile_model(model)


@pytest.fixture(scope="module")
def pendulum():
    model = load_model_file(CONFIGS / "double_pendulum.py", "DoublePendulum")
    return model, compile_model(model)


class Integrator(Model):
    """x_next = 2 x + u + n, y = (x, x + u): the second output has feedthrough."""

    name = "integrator"
    states = (Quantity("x"),)
    inputs = (Quantity("u"),)
    noises = (Quantity("n"),)
    outputs = (Quantity("x"), Quantity("sum"))
    sample_time = 1.0
    discretisation = "discrete"

    def dynamics(self, x, u, v, p):
        return [2 * x.x + u.u + v.n]

    def output(self, x, u, p):
        return [x.x, x.x + u.u]


@pytest.fixture(scope="module")
def integrator():
    return Integrator(), compile_model(Integrator())


def same(a, b):
    return all(
        np.array_equal(getattr(r, part), getattr(s, part))
        for r, s in zip(a.recordings, b.recordings, strict=True)
        for part in ("x_true", "u", "y")
    )


def test_streams_depend_on_seed_replicate_and_test_only(pendulum):
    model, compiled = pendulum
    plan = plan_motion("zero", Zero(), model, compiled, 50)

    def run(tests=2, **keys):
        return simulate(model, compiled, plan, np.eye(2), 1e-6 * np.eye(2), samples=50, tests=tests, **keys)

    base = run(seed=7, replicate=3)
    assert same(base, run(seed=7, replicate=3))
    assert not same(base, run(seed=8, replicate=3))
    assert not same(base, run(seed=7, replicate=4))
    assert not np.array_equal(base.recordings[0].y, base.recordings[1].y)
    more = run(tests=3, seed=7, replicate=3)
    assert np.array_equal(more.recordings[1].y, base.recordings[1].y)


def test_first_noise_is_the_documented_stream(integrator):
    model, compiled = integrator
    plan = plan_motion("zero", Zero(), model, compiled, 3)
    Q, R = np.array([[4.0]]), np.diag([9.0, 0.0])
    data = simulate(
        model, compiled, plan, Q, R, seed=5, samples=3, tests=2, replicate=6, x0=np.array([1.0]), P0=np.array([[0.25]])
    )
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(5, spawn_key=(0, 6, 1))))
    v, e, first = rng.standard_normal((2, 1)), rng.standard_normal((3, 2)), rng.standard_normal(1)
    x = [1 + 0.5 * first[0]]
    for k in range(2):
        x.append(2 * x[-1] + 2 * v[k, 0])
    r = data.recordings[1]
    np.testing.assert_allclose(r.x_true[:, 0], x, rtol=1e-14)
    np.testing.assert_allclose(r.y, np.column_stack([x + 3 * e[:, 0], x]), rtol=1e-14)


def test_dataset_carries_the_truth(robot):
    model, compiled = robot
    plan = plan_motion("square", Square(), model, compiled, 20)
    data = simulate(model, compiled, plan, Q_ROBOT, R_ROBOT, seed=1, samples=20, tests=2, name="trial")
    assert (data.name, data.model, len(data.recordings)) == ("trial", "flexible_robot", 2)
    assert [r.name for r in data.recordings] == ["test 1", "test 2"]
    np.testing.assert_array_equal(data.Q_true, Q_ROBOT)
    np.testing.assert_array_equal(data.R_true, R_ROBOT)
    assert data.inputs[0] == ("u1", "N m", "torque of motor 1")
    groups = (data.states, data.outputs, data.performances)
    assert [[c[0] for c in g] for g in groups] == [list(compiled.states), list(compiled.outputs), ["px", "py"]]
    r = data.recordings[0]
    assert (r.x_true.shape, r.u.shape, r.y.shape, r.z_true.shape) == ((20, 8), (20, 2), (20, 4), (20, 2))
    np.testing.assert_array_equal(r.dt, np.full(19, 5e-4))
    h = np.empty(4)
    for k in (0, 7, 19):  # every output, the fed-through ones too, is taken with the input of its own sample
        compiled.output(r.x_true[k].copy(), r.u[k].copy(), compiled.parameters, h)
        assert (np.abs(r.y[k] - h) < 6 * np.sqrt(np.diag(R_ROBOT))).all()


def recovered_noise(compiled, r):
    """Least-squares solution v of x_next = F1 + F2 v along the true states."""
    x_next, F = np.empty(compiled.nx), np.empty((compiled.nx, compiled.nx))
    G, work = np.empty((compiled.nx, compiled.nv)), workspace(compiled.nx, compiled.nv)
    v = []
    for k in range(r.samples - 1):
        arguments = (r.x_true[k].copy(), r.u[k].copy(), r.dt[k], compiled.parameters)
        transition(compiled.scheme, compiled.drift_jacobian, *arguments, x_next, F, G, work)
        v.append(np.linalg.lstsq(G, r.x_true[k + 1] - x_next, rcond=None)[0])
    return np.array(v)


def assert_sample_covariance(samples, expected):
    """Each entry within five standard errors, Var = (C_ij^2 + C_ii C_jj) / n; the mean likewise."""
    n = len(samples)
    variance = np.diag(expected)
    error = np.sqrt((expected**2 + np.outer(variance, variance)) / n)
    assert (np.abs(samples.T @ samples / n - expected) <= 5 * error).all()
    assert (np.abs(samples.mean(axis=0)) <= 5 * np.sqrt(variance / n)).all()


def test_noise_has_the_covariances_asked_for(pendulum):
    model, compiled = pendulum
    plan = plan_motion("multisine", Multisine((0.3, 0.1), 0.5, 3.0, 4), model, compiled, 1500)
    Q, R = np.array([[4.0, 1.8], [1.8, 1.0]]), np.array([[1e-6, -4e-7], [-4e-7, 1e-6]])
    data = simulate(model, compiled, plan, Q, R, seed=3, samples=1500)
    r = data.recordings[0]
    assert_sample_covariance(recovered_noise(compiled, r), Q)
    assert_sample_covariance(r.y - r.x_true[:, :2], R)


def test_robot_noise_enters_through_the_inertia(robot):
    model, compiled = robot
    plan = plan_motion("square", Square(), model, compiled, 1000)
    r = simulate(model, compiled, plan, Q_ROBOT, R_ROBOT, seed=4, samples=1000).recordings[0]
    assert_sample_covariance(recovered_noise(compiled, r), Q_ROBOT)


def test_4000_samples_take_well_under_a_second(robot):
    model, compiled = robot
    plan = plan_motion("square", Square(), model, compiled, 4000)
    simulate(model, compiled, plan, Q_ROBOT, R_ROBOT, seed=1, samples=10)
    start = time.process_time()
    simulate(model, compiled, plan, Q_ROBOT, R_ROBOT, seed=1, samples=4000)
    assert time.process_time() - start < 1.0


def test_first_state_is_drawn_with_its_covariance(integrator):
    model, compiled = integrator
    plan = plan_motion("zero", Zero(), model, compiled, 1)
    data = simulate(
        model, compiled, plan, np.eye(1), np.eye(2), seed=1, samples=1, tests=2000, x0=np.array([3.0]), P0=4 * np.eye(1)
    )
    x = np.array([r.x_true[0] for r in data.recordings])
    assert_sample_covariance(x - 3, 4 * np.eye(1))


class Feedback:
    """Sets u = -gain times what it reads."""

    def __init__(self, reads):
        self.reads = reads
        self.seen = []

    def start(self):
        self.seen.clear()

    def control(self, k, y):
        self.seen.append(y.copy())
        return -1.5 * y[list(self.reads)]


def test_controller_sees_the_sample_it_acts_on(integrator):
    """It reads y of the same sample, noise included, and NaN where it may not read."""
    _, compiled = integrator
    controller = Feedback((0,))
    v, e = np.array([[0.1], [0.2]]), np.array([[0.01, 5.0], [0.02, 6.0], [0.03, 7.0]])
    out = rollout(compiled, controller, np.array([1.0]), v, e, 1.0)
    x, expected = 1.0, []
    for k in range(3):
        u = -1.5 * (x + e[k, 0])
        expected.append((x, u, x + e[k, 0], x + u + e[k, 1]))
        x = 2 * x + u + (v[k, 0] if k < 2 else 0.0)
    np.testing.assert_allclose(np.column_stack([out.x, out.u, out.y]), expected, rtol=1e-13)
    seen = np.array(controller.seen)
    np.testing.assert_array_equal(seen[:, 0], out.y[:, 0])
    assert np.isnan(seen[:, 1]).all()


def test_algebraic_loop_is_refused(integrator):
    _, compiled = integrator
    with pytest.raises(DataError, match=r"reads sum, which depends on the input that it sets \(sample 0\)"):
        rollout(compiled, Feedback((1,)), np.array([1.0]), np.zeros((2, 1)), np.zeros((3, 2)), 1.0)


def test_divergence_names_test_sample_time_and_state(integrator):
    model, compiled = integrator
    plan = plan_motion("zero", Zero(), model, compiled, 2000)
    none = (np.zeros((1, 1)), np.zeros((2, 2)))
    with pytest.raises(
        DataError, match=r"test 1: .* at sample 1024 \(t = 1024 s\); the last finite state is x = 8\.988e\+307"
    ):
        simulate(model, compiled, plan, *none, seed=1, samples=2000, x0=np.array([1.0]))
    with pytest.raises(DataError, match="test 1: the first state is not finite"):
        simulate(model, compiled, plan, *none, seed=1, samples=2, x0=np.array([np.nan]))


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"Q": np.eye(2)}, r"process_noise has the shape \(2, 2\); it must be \(1, 1\)"),
        ({"R": np.diag([1.0, -1.0])}, "measurement_noise is not positive semidefinite: its smallest eigenvalue is -1"),
        ({"R": np.array([[1.0, 0.5], [0.0, 1.0]])}, "measurement_noise is not a finite symmetric"),
        ({"Q": np.array([[np.nan]])}, "process_noise is not a finite symmetric"),
        ({"P0": np.eye(2)}, "initial_covariance has the shape"),
        ({"x0": np.zeros(2)}, r"first state has the shape \(2,\); integrator has 1 states"),
        ({"samples": 0}, "at least one sample"),
        ({"tests": 0}, "at least one sample and one test"),
    ],
)
def test_wrong_arguments(integrator, changes, text):
    model, compiled = integrator
    plan = Plan(signals.Signal(np.zeros((5, 1))), np.zeros(1))
    arguments = {"Q": np.eye(1), "R": np.eye(2), "seed": 1, "samples": 5} | changes
    with pytest.raises(DataError, match=text):
        simulate(model, compiled, plan, **arguments)


def test_factor_of_definite_semidefinite_and_zero_covariances():
    rng = np.random.default_rng(1)
    for rank in (0, 1, 2, 3, 4):
        half = rng.normal(size=(4, rank)) * np.array([1e-6, 1e-3, 1, 1e3])[:, None]
        C = half @ half.T
        L = covariance_factor("Q", C, 4)
        np.testing.assert_allclose(L @ L.T, C, rtol=0, atol=1e-14 * max(np.abs(C).max(), 1e-300))


def test_multisine_has_the_lines_asked_for():
    N, dt = 1000, 0.01
    u = signals.multisine(dt * np.arange(N), np.array([2.0, 0.5]), 1.0, 8.0, 4)
    np.testing.assert_allclose(np.abs(u).max(axis=0), [2.0, 0.5], rtol=1e-12)
    spectrum = np.abs(np.fft.rfft(u, axis=0))
    lines = [set(np.flatnonzero(s > 1e-6 * s.max()) / (N * dt)) for s in spectrum.T]
    assert lines == [{1.0, 3.0, 5.0, 7.0}, {2.0, 4.0, 6.0, 8.0}]
    strong = [s[s > 1e-6 * s.max()] for s in spectrum.T]
    assert all(np.allclose(s, s[0]) for s in strong)


def test_steps_go_through_all_signs():
    u = signals.steps(0.1 * np.arange(12), np.array([1.0, 3.0]), 0.3)
    np.testing.assert_array_equal(u[:, 0], np.repeat([1, -1, 1, -1], 3))
    np.testing.assert_array_equal(u[:, 1], np.repeat([3, -3], 6))


@pytest.mark.parametrize("kind", ["zero", "multisine", "steps"])
def test_open_loop_motions_serve_any_model(pendulum, robot, kind):
    for model, compiled in (pendulum, robot):
        options = {
            "zero": Zero(),
            "multisine": Multisine((0.2, 0.1), 1.0, 4.0, 3),
            "steps": Steps((0.2, 0.1), 0.05),
        }[kind]
        plan = plan_motion(kind, options, model, compiled, 100)
        quiet = (np.zeros((compiled.nv, compiled.nv)), np.zeros((compiled.ny, compiled.ny)))
        u = simulate(model, compiled, plan, *quiet, seed=1, samples=100).recordings[0].u
        expected = {
            "zero": np.zeros((100, 2)),
            "multisine": signals.multisine(model.sample_time * np.arange(100), np.array([0.2, 0.1]), 1.0, 4.0, 3),
            "steps": signals.steps(model.sample_time * np.arange(100), np.array([0.2, 0.1]), 0.05),
        }[kind]
        np.testing.assert_array_equal(u, expected)


@pytest.mark.parametrize(
    ("kind", "options", "text"),
    [
        ("spiral", Zero(), "kind spiral is not known; known: square, zero, multisine, steps"),
        ("square", Square(), "kind square is not for double_pendulum; for this model: zero, multisine, steps"),
        ("multisine", Multisine((1.0,), 1.0, 2.0), "amplitude has 1 values; double_pendulum has 2 inputs: tau1, tau2"),
        ("multisine", Multisine((1.0, 1.0), 1.0, 250.0), "highest < 250 Hz"),
        ("multisine", Multisine((1.0, 1.0), 0.0, 2.0), "0 < lowest"),
        ("multisine", Multisine((1.0, 1.0), 1.0, 2.0, 0), "lines must be at least 1"),
        ("steps", Steps((1.0, 1.0, 1.0), 0.1), "amplitude has 3 values"),
        ("steps", Steps((1.0, 1.0), 0.0), "hold must be above 0 s"),
    ],
)
def test_motions_that_do_not_fit(pendulum, kind, options, text):
    model, compiled = pendulum
    with pytest.raises(ModelError, match=text):
        plan_motion(kind, options, model, compiled, 10)


@pytest.mark.parametrize("options", [Square(side=0.0), Square(side_time=0.0)])
def test_square_needs_a_size(robot, options):
    with pytest.raises(ModelError, match="side and side_time must be above 0"):
        plan_motion("square", options, *robot, 10)


def test_every_motion_has_options_and_a_builder():
    assert all(callable(m.build) and hasattr(m.options, "__dataclass_fields__") for m in MOTIONS.values())
