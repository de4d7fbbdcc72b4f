"""Degenerate problems through the command line, from a log file to the report: a labelled status or a sentence.

Warnings are errors here, those of the figures too, and no message is of a bug.
"""

import numpy as np
import pytest
from degenerate_problems import MODELS, PATH, UNOBSERVABLE, WALKS, experiment
from small_experiment import noiseid

from noiseid_cli.storage.result_file import read_result_attributes

WALK = WALKS[0][:, 0]
OUTLIER = np.where(np.arange(len(WALK)) == 15, 1e8, WALK)
ONLINE = ("em", "ml", "asrukf")
NOT_ZERO = "must not be 0: give a positive value"
NOT_POSITIVE = "S = [[1. 1.] [1. 1.]]. The filter has diverged or R is singular: look at R"
CASES = {
    "no samples": ({}, WALK[:0], ("em",), {"em": "log.csv has no data rows"}),
    "one sample": ({}, WALK[:1], ("em",), {"em": "test 'log' has 1 sample; at least 2 are needed"}),
    "all missing": ({}, WALK * np.nan, ONLINE, dict.fromkeys(ONLINE, "nothing was measured: every output")),
    "constant": ({}, WALK * 0 + 3.0, ONLINE, {}),
    "outlier": ({}, OUTLIER, ONLINE, {}),
    "1e150": ({}, WALK * 1e150, ONLINE, {}),
    "1e-160": ({}, WALK * 1e-160, ONLINE, {}),
    "Q0 = 0": (MODELS["Q0 = 0"], WALK, ("em",), {"em": NOT_ZERO}),
    "R = 0": (MODELS["R = 0"], WALK, ("em",), {"em": NOT_ZERO}),
    "Q0 = 1e-300": (MODELS["Q0 = 1e-300"], WALK, ONLINE, {}),
    "R = 1e-300": (MODELS["R = 1e-300"], WALK, ("em",), {}),
    "P0 = 0": (MODELS["P0 = 0"], WALK, ONLINE, {}),
    "P0 singular": ({"model": UNOBSERVABLE, "q": [1.0, 1.0], "p": [1.0, 0.0]}, WALK, ONLINE, {}),
    "P0 = 1e16": (MODELS["P0 = 1e16"], WALK, ("em",), {}),
    "unobservable": (MODELS["unobservable"], WALK, ONLINE, {}),
    "unstable": (MODELS["unstable"], WALK, ONLINE, {}),
    "unstable beyond all numbers": (MODELS["unstable beyond all numbers"], WALK, ONLINE, {}),
    "duplicated outputs": (MODELS["duplicated outputs"], WALK, ONLINE, {"em": NOT_POSITIVE, "ml": NOT_POSITIVE}),
}
"""What is changed in the experiment, the log, the methods, and the sentence of those that refuse."""


@pytest.mark.parametrize("name", CASES)
def test_each_ends_in_a_status_or_a_sentence(tmp_path, monkeypatch, name):
    changes, values, methods, refusals = CASES[name]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    cells = ("" if np.isnan(y) else repr(float(y)) for y in values)
    (tmp_path / "log.csv").write_text("t,y\n" + "".join(f"{k},{cell}\n" for k, cell in enumerate(cells)))
    (tmp_path / "level.py").write_text(PATH)
    for method in methods:
        text = experiment(method, **changes).replace(", other: {file: log.csv}", "")
        page = "html" if method == "em" else "csv"
        (tmp_path / "noiseid.yaml").write_text(f"{text}report: {{formats: [{page}]}}\n")
        ended = noiseid("run", "-q", "-o", method)
        assert "internal" not in ended.stderr, ended.stderr
        if method in refusals:
            assert ended.exit_code == 3
            assert refusals[method] in " ".join(ended.stderr.split())
            continue
        (result,) = (tmp_path / method).rglob("results/*.h5")
        status = read_result_attributes(result)["status"]
        assert ended.exit_code == (0 if status == "converged" else 4)
        assert (
            status == "converged"
            or f"1 of 1 unit did not converge: first, degenerate/{method}/start-0 ({status})" in (ended.stderr)
        )
        assert list((tmp_path / method).rglob("report.html" if page == "html" else "results.csv"))
