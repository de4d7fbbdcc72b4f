"""A synthetic study of two online methods: one drifts while the motion is held, the other holds what it cannot see."""

from dataclasses import replace

import numpy as np
import report_cases as cases

from noiseid_cli.estimators.estimate import Estimate, NoiseValues, Parameters, Series
from noiseid_cli.outcome import UnitResult

UNKNOWNS = (
    ("v_q", "rad^2", "variance of the noise of the angle"),
    ("mu", "N m s/rad", "viscous friction"),
    ("m", "kg", "mass"),
)
STATES = (("q", "rad", "angle"), ("dq", "rad/s", "speed"))
AT = np.linspace(0.0, 20.0, 401)
CHANGE, HOLD = 8.0, (8.0, 12.0)
INSIDE = (HOLD[0] <= AT) & (HOLD[1] > AT)
START = np.array([1e-7, 0.15, 0.5])
BIAS = {"asrukf": (9.0, -0.04, 0.02), "sb-asrukf": (9.0, 0.0, 0.02)}
"""Relative error of each unknown, of the first seed, towards which it decays; seed n adds 0.01 n to the last."""


def truth():
    """(n, 3) the friction is doubled where the motion comes to rest."""
    values = np.tile([1e-10, 0.05, 2.0], (len(AT), 1))
    values[AT >= CHANGE, 1] *= 2
    return values


def estimates(method, seed):
    """Exponential approach within 1 s; without a monitor the friction runs off while the motion is held."""
    goal = truth() * (1 + np.array(BIAS[method]) + np.array([0, 0, 0.01 * seed]))
    old = goal[0] + (START - goal[0]) * np.exp(-AT[:, None])
    frozen = method == "sb-asrukf"
    since = np.clip(AT - (HOLD[1] if frozen else CHANGE), 0, None)[:, None]
    new = goal + (old[CHANGE > AT][-1] - goal) * np.exp(-since)
    values = np.where((CHANGE > AT)[:, None], old, new)
    if frozen:
        values[INSIDE, 1] = values[CHANGE > AT][-1, 1]
    else:
        values[INSIDE, 1] += 60 * (1 + seed) * 0.1 * np.sin(np.pi * (AT[INSIDE] - HOLD[0]) / 4)
    return values


def gate(method):
    flags = np.ones((len(AT), 3))
    if method == "sb-asrukf":
        flags[INSIDE, 1] = 0
    return flags


def curves(method, seed, with_truth=True):
    def make(name, columns, values):
        return Series(name, name.replace("_", " "), ("time", "s"), AT, columns, values)

    values = estimates(method, seed)
    wave = np.column_stack([np.sin(AT), np.cos(AT)])
    seen = np.abs(np.column_stack([np.ones(len(AT)), np.cos(AT) * gate(method)[:, 1], np.sin(AT)]))
    found = [
        make("parameters", UNKNOWNS, values),
        make("parameters_std", UNKNOWNS, 0.05 * np.abs(values)),
        make("sensitivity", UNKNOWNS, seen),
        make("sensitivity_open_loop", UNKNOWNS, 0.9 * seen + 0.05),
        make("open", UNKNOWNS, gate(method)),
        make("states", STATES, wave * (1 + 0.01 * seed)),
        make("states_std", STATES, 0.01 + 0 * wave),
    ]
    if with_truth:
        found += [make("parameters_true", UNKNOWNS[1:], truth()[:, 1:]), make("states_true", STATES, wave)]
    return tuple(found)


def unit(method, seed=0, *, status="converged", with_truth=True):
    values = NoiseValues(np.diag([1e-8, 1e-4]), np.eye(1), np.zeros((1, 2)), np.eye(2))
    series = curves(method, seed, with_truth)
    last = series[0].values[-1]
    estimate = Estimate(
        method=method,
        status=status,
        reason="The filter has run over the whole recording.",
        start=values,
        final=replace(values, Q=np.diag([last[0], 1e-4])),
        loglik_start=float("nan"),
        loglik=100.0,
        passes=1,
        seconds=0.5,
        parameters=Parameters(UNKNOWNS[1:], START[1:], last[1:], 0.05 * last[1:]),
        series=series,
    )
    return UnitResult(
        unit=f"replicate-{seed:03d}/{method}/start-0",
        dataset=f"replicate-{seed:03d}",
        method_label=method,
        start_index=0,
        start_label="× 1",
        replicate=seed,
        estimate=estimate,
        evaluations={},
        noise_names=(("v_q", "rad", "noise of the angle"), ("v_dq", "rad/s", "noise of the speed")),
        output_names=(("q", "rad", "angle"),),
        state_names=STATES,
        test_names=("test 1",),
        Q_true=np.diag([1e-10, 1e-4]) if with_truth else None,
        R_true=np.eye(1) if with_truth else None,
        seconds=0.6,
        seed=1,
        parameters_true=truth()[-1, 1:] if with_truth else None,
    )


def study(results=None, held=HOLD):
    """Two methods on three seeds, unless other results are given."""
    results = results or [unit(method, seed) for seed in range(3) for method in ("asrukf", "sb-asrukf")]
    base = cases.study(results)
    data = [
        replace(base.datasets[0], name=name, held=held, times=(), performance_unit="")
        for name in dict.fromkeys(r.dataset for r in results)
    ]
    return replace(base, datasets=data)
