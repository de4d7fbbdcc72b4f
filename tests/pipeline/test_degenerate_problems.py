"""Every degenerate problem before every method: a status or a sentence, never a warning, a silent NaN or a traceback.

Warnings are errors here, so that a number that overflows on its way into a table fails the test.
"""

import numpy as np
import pytest
from degenerate_problems import DATA, METHODS, MODELS, outcome

from noiseid_cli.errors import NoiseidError
from noiseid_cli.storage.result_file import read_result

CASES = [(name, {"outputs": outputs}) for name, outputs in DATA.items()] + list(MODELS.items())
WITHOUT_NUMBERS = ("all missing", "infinite")


@pytest.mark.parametrize("method", METHODS)
def test_each_ends_in_a_status_or_a_sentence(tmp_path, method):
    ended = {}
    for name, case in CASES:
        if method == "alg2" and len(case.get("r", case.get("q", (0,)))) > 1:
            continue  # its model has one state
        folder = tmp_path / name
        folder.mkdir()
        try:
            token = outcome(folder, method, **case)
        except NoiseidError as error:
            ended[name] = str(error)
            continue
        ended[name] = token.status or token.message
        if token.state == "failed":
            assert token.message.rstrip()
            continue
        estimate = read_result(token.path).estimate
        assert estimate.reason or estimate.status == "converged"
        values = [estimate.final.Q, estimate.final.R, estimate.final.P0, estimate.final.m0]
        if method != "recursive-ml":  # which never sees all tests at once, and has no likelihood
            values.append(np.array(estimate.loglik))
        if estimate.parameters is not None:
            values.append(estimate.parameters.final)
        if estimate.status != "diverged":
            assert all(np.isfinite(value).all() for value in values), name
    assert all("Traceback" not in said for said in ended.values())
    for name in WITHOUT_NUMBERS:
        assert " " in ended[name], f"{name}: {ended[name]}"  # a sentence, not a status
    if method in ("em", "alg2", "alg3", "asrukf", "ml"):
        for name in ("Q0 = 0", "R = 0"):
            assert "must not be 0: give a positive value" in ended[name]
    assert ended["unstable beyond all numbers"] != "converged"
