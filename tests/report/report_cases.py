"""Synthetic studies: a simulated one with a truth, a measured one without, and one with many units."""

from dataclasses import replace

import numpy as np

from noiseid_cli.diagnostics.consistency import consistency
from noiseid_cli.estimators.estimate import Estimate, NoiseValues
from noiseid_cli.outcome import UnitResult
from noiseid_cli.report import DatasetFacts, EquationFact, ModelFacts, ParameterFact, Study

NOISES = (
    ("va1", "N m", "torque noise, arm 1"),
    ("va2", "N m", "torque noise, arm 2"),
    ("vm1", "N m", "torque noise, motor 1"),
    ("vm2", "N m", "torque noise, motor 2"),
)
OUTPUTS = (
    ("qm1", "rad", "motor angle 1"),
    ("qm2", "rad", "motor angle 2"),
    ("acc1", "m/s^2", "tool acceleration, horizontal"),
    ("acc2", "m/s^2", "tool acceleration, vertical"),
)
TRUE_STD = np.array([50.0, 20.0, 30.0, 15.0])
R = np.diag([1e-12, 1e-12, 1e-3, 1e-3])
RHO = 0.2 * np.ones((4, 4)) + 0.8 * np.eye(4)


def evaluation(label, rng, scale, colour, samples, outputs, truth):
    """A filter whose innovations are ``scale`` times as large as it says, and correlated by ``colour``."""
    ny = len(outputs)
    white = rng.normal(size=(samples + 1, ny))
    nu = scale * (white[1:] + colour * white[:-1]) / np.sqrt(1 + colour**2)
    nu[samples // 2 : samples // 2 + 5, 0] = np.nan
    half = samples // 2
    S = np.broadcast_to(np.eye(ny), (samples, ny, ny))
    error = None
    if truth:
        wave = 1.3 + np.sin(np.arange(samples) / 90)
        error = list(np.split(1e-4 * max(scale, 1 / scale) * wave * np.abs(rng.normal(size=samples)), [half]))
    return consistency(
        label,
        np.split(nu, [half]),
        np.split(S, [half]),
        70_000 - 3_000 * np.log(scale) ** 2,
        path_error=error,
    )


def trace(rng, method, scale, end, loglik, estimates_R):
    """A path from the start to the end: geometric for plain EM, faster and with rejected steps otherwise."""
    passes, rate = (40, 0.6) if method == "em" else (400, 0.97)
    weight = rate ** np.arange(passes)
    start = np.diag(scale * TRUE_STD**2)
    Q = np.array([w * start + (1 - w) * end for w in weight])
    values = loglik - 20_000 * weight**2
    accepted = np.ones(passes)
    if method == "em":
        accepted[[6, 13]] = 0
        values[[6, 13]] -= 900
    r = np.array([R * (1 + w) for w in weight]) if estimates_R else np.broadcast_to(R, (passes, 4, 4)).copy()
    return {
        "loglik": values,
        "Q": Q,
        "R": r,
        "change": weight,
        "extrapolated": 1 - accepted,
        "accepted": accepted,
    }


def unit(
    method,
    start,
    *,
    replicate=0,
    truth=True,
    samples=1200,
    status="converged",
    estimates_R=False,
    dataset=None,
):
    """One unit of the flexible robot."""
    rng = np.random.default_rng([replicate, start, len(method)])
    scale = (0.01, 100.0)[start % 2]
    Q_true = np.outer(TRUE_STD, TRUE_STD) * RHO
    end = Q_true * (1 + 0.02 * rng.normal())
    values = NoiseValues(np.diag(scale * TRUE_STD**2), R * (2 if estimates_R else 1), np.zeros((2, 8)), np.eye(8))
    final = replace(values, Q=end, R=R)
    evaluations = {
        "start": evaluation("start", rng, scale**-0.25, 0.2, samples, OUTPUTS, truth),
        "estimate": evaluation("estimate", rng, 1.0, 0.25, samples, OUTPUTS, truth),
    }
    if truth:
        evaluations["truth"] = evaluation("truth", rng, 1.0, 0.0, samples, OUTPUTS, truth)
    loglik = evaluations["estimate"].loglik
    history = trace(rng, method, scale, end, loglik, estimates_R)
    estimate = Estimate(
        method="em",
        status=status,
        reason="The log-likelihood rose by less than 1e-9 relative, and Q changed by less than 1e-4.",
        start=values,
        final=final,
        loglik_start=evaluations["start"].loglik,
        loglik=loglik,
        passes=len(history["loglik"]),
        seconds=1.5 + 0.25 * start,
        trace=history,
        safeguards=("2 accelerated steps were rejected.",) if method == "em" else (),
        settings={
            "acceleration": "quasi_newton" if method == "em" else "none",
            "max_passes": 1000,
            "tolerance": 1e-4,
        },
    )
    return UnitResult(
        unit=f"replicate-{replicate:03d}/{method}/start-{start}",
        dataset=dataset or "simulated",
        method_label=method,
        start_index=start,
        start_label=f"× {scale:g}",
        replicate=replicate,
        estimate=estimate,
        evaluations=evaluations,
        noise_names=NOISES,
        output_names=OUTPUTS,
        state_names=(("qa1", "rad", "arm angle 1"),),
        test_names=("square-1", "square-2"),
        Q_true=Q_true if truth else None,
        R_true=R if truth else None,
        seconds=2.0,
        seed=2011,
    )


def diverged(result):
    """The same unit, ended without a usable estimate."""
    nothing = np.full((4, 4), np.nan)
    estimate = replace(
        result.estimate,
        status="diverged",
        reason="The filter's state left the finite numbers in test square-1 at sample 17.",
        final=replace(result.estimate.final, Q=nothing),
        loglik=float("nan"),
        passes=3,
        trace={key: value[:3] for key, value in result.estimate.trace.items()},
    )
    return replace(result, estimate=estimate, evaluations={"start": result.evaluations["start"]})


def study(results, *, samples=1200, truth=True):
    """A study around results."""
    t = np.arange(samples // 2) * 0.0005
    data = DatasetFacts(
        name="simulated" if truth else "excited",
        origin="simulated" if truth else "imported",
        tests=2,
        samples=samples,
        duration=2 * float(t[-1]),
        missing_share=5 / (4 * samples),
        notes=() if truth else ("3 rows with repeated times were dropped.", "5 values were missing."),
        times=(t, t),
        performance_unit="m" if truth else "",
    )
    model = ModelFacts(
        name="flexible_robot",
        description="A two-link robot with flexible joints, moving in a horizontal plane.",
        equations=(
            EquationFact("definition", "T = k·x", "<mrow><mi>T</mi><mo>=</mo><mi>k</mi><mo>·</mo><mi>x</mi></mrow>"),
            EquationFact("dynamics", "Mm qm'' - T(qa - qm) = u + vm"),
        ),
        parameters=(
            ParameterFact("m1", 40.0, "kg", "mass of arm 1", "Moberg (2010), table 3.1"),
            ParameterFact("k1", 1.1e7, "N m/rad", "stiffness of joint 1", "chosen"),
            ParameterFact("fd", 0.0, "", "friction", "chosen"),
        ),
    )
    return Study(
        title="Flexible robot, process noise by EM",
        experiment="flexible_robot",
        results=list(results),
        model=model,
        datasets=[data],
        environment={"noiseid": "0.1.0", "numpy": "2.1.0", "Python": "3.11.2"},
        reproduce=["noiseid init flexible_robot", "noiseid run flexible_robot.yaml --seed 2011"],
        warnings=[] if truth else ["R is below 1/12 of the squared encoder step: implausible for a quantised sensor."],
        citations=["Axelsson, P. et al. (2011). ML estimation of process noise variance in dynamic systems."],
    )


def simulated(**options):
    """Two methods from two starts each, with a truth."""
    return study([unit(m, s, **options) for m in ("em", "em-plain") for s in (0, 1)], **_sizes(options))


def measured(**options):
    """One method from one start, no truth, R estimated."""
    return study([unit("em", 0, truth=False, estimates_R=True, dataset="excited", **options)], truth=False)


def many(replicates=10, samples=300):
    """Two methods from two starts on each replicate; every seventh unit diverged."""
    units = [
        unit(m, s, replicate=n, samples=samples) for n in range(replicates) for m in ("em", "em-plain") for s in (0, 1)
    ]
    return study([diverged(u) if i % 7 == 3 else u for i, u in enumerate(units)], samples=samples)


def _sizes(options):
    return {"samples": options["samples"]} if "samples" in options else {}
