"""The flexible robot on its square: path, inverse kinematics, reference, controller and closed loop."""

import numpy as np
import pytest

from noiseid_cli.errors import ModelError
from noiseid_cli.models.compile import compile_model
from noiseid_cli.models.registry import load_model
from noiseid_cli.simulation.motions import Square, plan_motion
from noiseid_cli.simulation.robot_controller import FILTER, KP, KV, RobotController, robot_reference
from noiseid_cli.simulation.simulate import simulate
from noiseid_cli.simulation.trajectory import SquarePath, arm_reference

PATH = SquarePath(corner=(1.2, 0.7), side=0.2, side_time=0.5)
L1, L2, DT = 0.9, 1.0, 5e-4


@pytest.fixture(scope="module")
def robot():
    model = load_model("flexible_robot")
    return model, compile_model(model)


def differences(values, h):
    """First and second central differences of fourth order, without two rows at each end."""
    a, b, c, d, e = (values[i : len(values) - 4 + i] for i in range(5))
    return (a - 8 * b + 8 * d - e) / (12 * h), (-a + 16 * b - 30 * c + 16 * d - e) / (12 * h**2)


def test_path_visits_the_corners_and_rests_there():
    path = SquarePath(corner=(1.0, 0.5), side=0.3, side_time=0.4)
    position, velocity, acceleration = path.at(0.4 * np.arange(6))
    expected = [[1.0, 0.5], [1.0, 0.8], [1.3, 0.8], [1.3, 0.5], [1.0, 0.5], [1.0, 0.8]]
    np.testing.assert_allclose(position, expected, atol=1e-14)
    np.testing.assert_allclose(velocity, 0, atol=1e-12)
    np.testing.assert_allclose(acceleration, 0, atol=1e-10)
    middle = path.at(np.array([0.2]))
    np.testing.assert_allclose(middle[0], [[1.0, 0.65]], atol=1e-14)
    np.testing.assert_allclose(middle[1], [[0.0, 0.3 / 0.4 * 140 / 64]], atol=1e-13)


def test_path_derivatives_are_those_of_the_path():
    h = 1e-3
    time = h * np.arange(-400, 2400)
    position, velocity, acceleration = PATH.at(time)
    first, second = differences(position, h)
    # The fourth derivative jumps by J = 0.2 * 840 / 0.5^4 at a corner, where the difference errs by h^3 J / 36.
    np.testing.assert_allclose(first, velocity[2:-2], atol=8e-8)
    np.testing.assert_allclose(second, acceleration[2:-2], atol=1e-5)


def test_arm_reference_follows_the_tool_with_its_derivatives():
    h = 1e-3
    q, dq, ddq = arm_reference(PATH, h * np.arange(2000), L1, L2)
    s = q.sum(axis=1)
    tool = np.column_stack([L1 * np.sin(q[:, 0]) + L2 * np.cos(s), L1 * np.cos(q[:, 0]) - L2 * np.sin(s)])
    np.testing.assert_allclose(tool, PATH.at(h * np.arange(2000))[0], atol=1e-14)
    first, second = differences(q, h)
    # As for the path, times the inverse Jacobian of the arm, at most 2.5 rad/m.
    np.testing.assert_allclose(first, dq[2:-2], atol=2.5 * 8e-8)
    np.testing.assert_allclose(second, ddq[2:-2], atol=2.5 * 1e-5)
    elbow_height = L1 * np.cos(q[:, 0])
    assert (elbow_height > 0.5 * tool[:, 1]).all()


def test_path_out_of_reach():
    with pytest.raises(ModelError, match=r"between 0\.1 and 1\.9 m"):
        arm_reference(SquarePath((1.8, 0.7), 0.2, 0.5), np.linspace(0, 2, 9), L1, L2)


def test_reference_is_the_inverse_of_the_equations(robot):
    """Driven by the feedforward from the reference state, the arms and motors accelerate as the reference does."""
    _, compiled = robot
    reference = robot_reference(compiled, PATH, 400, DT, L1, L2)
    qa, dqa, ddqa = arm_reference(PATH, DT * np.arange(400), L1, L2)
    _, ddqm = differences(reference.qm, DT)
    dx = np.empty(8)
    for k in range(2, 398):
        carried = np.concatenate([qa[k], reference.qm[k], dqa[k], dqa[k]])
        compiled.drift(carried, np.zeros(2), np.zeros(4), compiled.parameters, dx)
        np.testing.assert_allclose(dx[4:6], ddqa[k], atol=1e-9)
        driven = np.concatenate([qa[k], reference.qm[k], reference.dqm[k], reference.dqm[k]])
        compiled.drift(driven, reference.u[k], np.zeros(4), compiled.parameters, dx)
        np.testing.assert_allclose(dx[6:8], ddqm[k - 2], atol=1e-6)
    first, _ = differences(reference.qm, DT)
    np.testing.assert_allclose(first, reference.dqm[2:-2], atol=1e-10)


def test_first_state_is_an_equilibrium(robot):
    _, compiled = robot
    x0 = robot_reference(compiled, PATH, 5, DT, L1, L2).x0
    # The drift is affine in the two torques, which drive the motors' rows only: those can always be brought to rest.
    rest, by = np.empty(8), np.empty((2, 8))
    compiled.drift(x0, np.zeros(2), np.zeros(4), compiled.parameters, rest)
    for j, unit in enumerate(np.eye(2)):
        compiled.drift(x0, unit, np.zeros(4), compiled.parameters, by[j])
    u0, dx = np.linalg.solve((by - rest)[:, 6:].T, -rest[6:]), np.empty(8)
    compiled.drift(x0, u0, np.zeros(4), compiled.parameters, dx)
    # Rounding of an angle of 0.3 rad (6e-17) times stiffness over inertia (1e5 / s^2), a few times.
    np.testing.assert_allclose(dx, 0, atol=1e-10)
    z = np.empty(2)
    compiled.performance(x0, u0, compiled.parameters, z)
    np.testing.assert_allclose(z, PATH.corner, atol=1e-14)
    assert (np.abs(x0[:2] - x0[2:4]) > 1e-4).all()  # gravity deflects both springs


def test_springs_that_cannot_carry_the_path(robot):
    """A NaN parameter cannot be balanced: the iteration ends with an error, not with garbage."""
    _model, compiled = robot
    broken = type(compiled)(**{**vars(compiled), "parameters": compiled.parameters * np.nan})
    with pytest.raises(ModelError, match="springs of the robot cannot carry"):
        robot_reference(broken, PATH, 5, DT, L1, L2)


def test_controller_is_the_printed_law(robot):
    _, compiled = robot
    reference = robot_reference(compiled, PATH, 50, DT, L1, L2)
    controller = RobotController(reference, DT)
    q = reference.qm + np.random.default_rng(1).normal(scale=1e-4, size=(50, 2))
    keep, speed = np.exp(-2 * np.pi * FILTER * DT), np.zeros(2)
    for repeat in range(2):
        controller.start()
        speed = np.zeros(2)
        for k in range(50):
            if k:
                speed = keep * speed + (1 - keep) * (q[k] - q[k - 1]) / DT
            expected = reference.u[k] + KP * (reference.qm[k] - q[k]) + KV * (reference.dqm[k] - speed)
            got = controller.control(k, np.array([*q[k], np.nan, np.nan]))
            np.testing.assert_allclose(got, expected, rtol=1e-12, err_msg=f"{repeat} {k}")


def test_closed_loop_is_stable_along_the_path(robot):
    """Eigenvalues of the loop of robot, filter and controller: at most 0.9958, where friction falls with speed."""
    _model, compiled = robot
    keep = np.exp(-2 * np.pi * FILTER * DT)
    qa, dqa, _ = arm_reference(PATH, DT * np.arange(0, 4000, 50), L1, L2)
    reference = robot_reference(compiled, PATH, 4000, DT, L1, L2)
    radius = []
    for k, (q, dq) in enumerate(zip(qa, dqa, strict=True)):
        x = np.concatenate([q, reference.qm[50 * k], dq, reference.dqm[50 * k]])
        f, A, B = np.empty(8), np.empty((8, 8)), np.empty((8, 4))
        compiled.drift_jacobian(x, np.zeros(2), compiled.parameters, f, A, B)
        F, G = np.eye(8) + DT * A, DT * B[:, 2:4]
        # State of the loop: x, last measured angle, filtered speed before this sample.
        pick = np.zeros((2, 8))
        pick[:, 2:4] = np.eye(2)
        speed = np.hstack([(1 - keep) / DT * pick, -(1 - keep) / DT * np.eye(2), keep * np.eye(2)])
        u = -np.hstack([KP[:, None] * pick, np.zeros((2, 4))]) - KV[:, None] * speed
        loop = np.vstack([np.hstack([F, np.zeros((8, 4))]) + G @ u, np.hstack([pick, np.zeros((2, 4))]), speed])
        radius.append(np.abs(np.linalg.eigvals(loop)).max())
    assert max(radius) == pytest.approx(0.9958, abs=1e-4)


@pytest.fixture(scope="module")
def quiet(robot):
    """Three rounds without noise."""
    model, compiled = robot
    plan = plan_motion("square", Square(), model, compiled, 12000)
    none = (np.zeros((4, 4)), np.zeros((4, 4)))
    return simulate(model, compiled, plan, *none, seed=1, samples=12000).recordings[0]


def test_tool_tracks_the_square(quiet):
    """Within 0.3 mm without noise; the error is the spring's damping torque, which the feedforward leaves out."""
    error = np.linalg.norm(quiet.z_true - PATH.at(quiet.time)[0], axis=1)
    assert error.max() < 3e-4
    assert error[0] < 1e-14


def test_path_repeats_every_4000_samples(quiet):
    """0.9958^4000 is below 1e-7: in the third round hardly anything is left of the start."""
    np.testing.assert_allclose(quiet.x_true[8000:], quiet.x_true[4000:8000], rtol=0, atol=1e-9)
    np.testing.assert_allclose(quiet.u[8000:], quiet.u[4000:8000], rtol=0, atol=1e-3)


def test_square_options_are_used(robot):
    model, compiled = robot
    options = Square(corner=(1.1, 0.8), side=0.1, side_time=0.25)
    plan = plan_motion("square", options, model, compiled, 2001)
    none = (np.zeros((4, 4)), np.zeros((4, 4)))
    z = simulate(model, compiled, plan, *none, seed=1, samples=2001).recordings[0].z_true
    expected = [[1.1, 0.8], [1.1, 0.9], [1.2, 0.9], [1.2, 0.8], [1.1, 0.8]]
    np.testing.assert_allclose(z[::500], expected, atol=1e-3)
