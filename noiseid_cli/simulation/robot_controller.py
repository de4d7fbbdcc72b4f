"""Position control of the flexible robot from its measured motor angles.

u = u_ff + Kp (qm_ref - qm) + Kv (qm_ref' - qm'), with qm' a filtered difference of the measured angle. Gains and filter
are chosen: the poster gives none. References follow from the compiled equations, so that no equation stands here twice.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import types

from noiseid_cli.errors import ModelError
from noiseid_cli.models.arrays import copy
from noiseid_cli.models.compiled import CompiledModel
from noiseid_cli.models.jit import kernel
from noiseid_cli.models.recording import Array
from noiseid_cli.models.signatures import DriftJacobian, matrix, vector
from noiseid_cli.simulation.trajectory import SquarePath, arm_reference

KP = np.array([2e5, 1e5])  # N m/rad, chosen
KV = np.array([1e4, 4.5e3])  # N m s/rad, chosen
FILTER = 200.0  # Hz, chosen: bandwidth of the differentiating filter


@dataclass(frozen=True)
class Reference:
    """What the motors should do.

    Attributes:
        qm: (N, 2) motor angles, rad.
        dqm: (N, 2) motor speeds, rad/s.
        u: (N, 2) feedforward torques, N m.
        x0: (8,) state at rest at the first sample, with the springs deflected by gravity.
    """

    qm: Array
    dqm: Array
    u: Array
    x0: Array


class RobotController:
    """Feedforward with proportional and speed feedback; see ``simulation.rollout.Controller``."""

    reads = (0, 1)

    def __init__(self, reference: Reference, dt: float) -> None:
        """Follow a reference that has one row for each sample of dt seconds."""
        self._reference = reference
        self._dt = dt
        self._keep = math.exp(-2 * math.pi * FILTER * dt)
        self.start()

    def start(self) -> None:
        """Forget the last test."""
        self._speed = np.zeros(2)
        self._last: Array | None = None

    def control(self, k: int, y: Array) -> Array:
        """(2,) motor torques at sample k from the measured motor angles y[:2]."""
        q = y[:2]
        if self._last is not None:
            self._speed = self._keep * self._speed + (1 - self._keep) * (q - self._last) / self._dt
        self._last = q
        r = self._reference
        torque: Array = r.u[k] + KP * (r.qm[k] - q) + KV * (r.dqm[k] - self._speed)
        return torque


def robot_reference(
    compiled: CompiledModel, path: SquarePath, samples: int, dt: float, l1: float, l2: float
) -> Reference:
    """Motor angles, speeds and torques that carry the tool along a path.

    The motor angle is the arm angle less the deflection whose spring torque moves the arm; its derivatives are central
    differences of fourth order; the torque is what that motor motion takes, spring torque and friction included.

    Args:
        compiled: the flexible robot.
        path: the tool's path.
        samples: number of samples N.
        dt: interval, s.
        l1, l2: arm lengths, m.

    Raises:
        ModelError: the path leaves the reach, or the springs cannot carry the torque.
    """
    time = dt * np.arange(-2, samples + 2, dtype=np.float64)
    qa, dqa, ddqa = arm_reference(path, time, l1, l2)
    qm = _motor_angles(compiled, qa, dqa, ddqa)
    before2, before1, here, after1, after2 = (qm[i : i + samples] for i in range(5))
    dqm = (before2 - 8 * before1 + 8 * after1 - after2) / (12 * dt)
    ddqm = (-before2 + 16 * before1 - 30 * here + 16 * after1 - after2) / (12 * dt**2)
    u = np.empty((samples, 2))
    _torques(compiled.drift_jacobian, compiled.parameters, qa[2:-2].copy(), here.copy(), dqm, ddqm, u)
    still = np.zeros((1, 2))
    qm0 = _motor_angles(compiled, qa[2:3], still, still)
    return Reference(qm=here, dqm=dqm, u=u, x0=np.concatenate([qa[2], qm0[0], np.zeros(4)]))


def _motor_angles(compiled: CompiledModel, qa: Array, dqa: Array, ddqa: Array) -> Array:
    qm = qa.copy()
    if not _balance(compiled.drift_jacobian, compiled.parameters, qa.copy(), dqa.copy(), ddqa.copy(), qm):
        raise ModelError(
            "the springs of the robot cannot carry the torque of this path; take a longer side_time or a shorter side."
        )
    return qm


@kernel(types.boolean(DriftJacobian, vector, matrix, matrix, matrix, matrix), allocates=True)
def _balance(jacobian, p, qa, dqa, ddqa, qm):  # type: ignore[no-untyped-def]
    """Newton's method, sample by sample, for the motor angles that give the arms their acceleration.

    The spring torque rises with the deflection ever more steeply, so that the iteration cannot cycle. Motor speeds
    equal arm speeds here: the damping carries no torque.
    """
    x, dx, A, B, u = np.zeros(8), np.zeros(8), np.zeros((8, 8)), np.zeros((8, 4)), np.zeros(2)
    for k in range(len(qa)):
        copy(qa[k], x[0:2])
        copy(dqa[k], x[4:6])
        copy(dqa[k], x[6:8])
        if k > 0:
            for i in range(2):
                qm[k, i] = qa[k, i] + qm[k - 1, i] - qa[k - 1, i]
        for attempt in range(50):
            copy(qm[k], x[2:4])
            jacobian(x, u, p, dx, A, B)
            r1, r2 = ddqa[k, 0] - dx[4], ddqa[k, 1] - dx[5]
            a, b, c, d = A[4, 2], A[4, 3], A[5, 2], A[5, 3]
            det = a * d - b * c
            step1, step2 = (d * r1 - b * r2) / det, (a * r2 - c * r1) / det
            qm[k, 0] += step1
            qm[k, 1] += step2
            if abs(step1) < 1e-15 and abs(step2) < 1e-15:
                break
            if attempt == 49:
                return False
    return True


@kernel(types.void(DriftJacobian, vector, matrix, matrix, matrix, matrix, matrix), allocates=True)
def _torques(jacobian, p, qa, qm, dqm, ddqm, u):  # type: ignore[no-untyped-def]
    """Torques u for given motor accelerations: dx[6:8] is affine in u with the diagonal gain of the motor noise."""
    x, dx, A, B, none = np.zeros(8), np.zeros(8), np.zeros((8, 8)), np.zeros((8, 4)), np.zeros(2)
    for k in range(len(qa)):
        copy(qa[k], x[0:2])
        copy(qm[k], x[2:4])
        copy(dqm[k], x[4:6])
        copy(dqm[k], x[6:8])
        jacobian(x, none, p, dx, A, B)
        for i in range(2):
            u[k, i] = (ddqm[k, i] - dx[6 + i]) / B[6 + i, 2 + i]
