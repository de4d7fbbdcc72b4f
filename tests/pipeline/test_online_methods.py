"""The online filters as tasks: what they are given reaches them, and what they cannot do is refused."""

from dataclasses import replace

import numpy as np
import pytest
from pendulum import Pendulum, pendulum_case

from noiseid_cli.config.methods import METHOD_OPTIONS
from noiseid_cli.estimators import adaptive_estimate
from noiseid_cli.estimators.adaptive_srukf import AdaptiveOptions
from noiseid_cli.estimators.structure import CovarianceStructure
from noiseid_cli.estimators.unknowns import ParameterUnknowns, Unknowns
from noiseid_cli.pipeline.methods import Task, run_method

PARAMETERS = ParameterUnknowns(("g",), np.array([10.0]), np.array([-np.inf]), np.array([np.inf]))


def task(method, unknown_Q=True, **options):
    compiled, noise, recordings = pendulum_case(1, lengths=(60,))
    unknowns = Unknowns(Q=CovarianceStructure.diagonal(noise.Q) if unknown_Q else None)
    given = METHOD_OPTIONS[method].model_validate(options).model_dump(exclude={"method", "structure"})
    return Task(compiled, Pendulum(), recordings, noise, unknowns, PARAMETERS, given, None)


@pytest.mark.parametrize("monitor", [False, True])
def test_the_adaptive_filters_run_with_their_options(monitor):
    table = {"g": 1.0, "v1": 1e-3}
    own = {"forgetting": 0.99, "alpha": 0.5, "window": 30}
    more = {"thresholds": {"g": 0.9}} if monitor else {}
    t = task("sb-asrukf" if monitor else "asrukf", parameter_covariance=table, **own, **more)
    found = run_method("sb-asrukf" if monitor else "asrukf", t)
    options = AdaptiveOptions(table, monitor=monitor, **own, **more)
    direct = adaptive_estimate.estimate(
        Pendulum(), t.model, t.recordings, t.start, t.unknowns, PARAMETERS, options
    )  # fmt: skip
    assert found.method == ("sb-asrukf" if monitor else "asrukf")
    assert np.array_equal(found.parameters.final, direct.parameters.final)
    assert np.array_equal(found.final.Q, direct.final.Q)
    assert found.settings["thresholds"] == ("g 0.9" if monitor else "none")


def test_the_joint_filter_holds_the_process_noise_when_told():
    tables = {"parameter_covariance": {"g": 1.0}, "parameter_noise": {"g": 1e-6}}
    held = run_method("joint-srukf", task("joint-srukf", hold_process_noise=True, **tables))
    known = run_method("joint-srukf", task("joint-srukf", unknown_Q=False, **tables))
    assert np.array_equal(held.parameters.final, known.parameters.final)
    assert np.array_equal(held.final.Q, replace(held.start).Q)
