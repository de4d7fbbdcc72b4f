"""What a user sees who asks for what cannot be: place, fault, what is allowed, and no traceback."""

from pathlib import Path

import pytest
from small_experiment import CONFIG, MEASURED, noiseid, write_experiment, write_recordings

LINEAR = CONFIG.replace(
    "{file: cart.py, class: Cart}", "{linear: {A: [[1, 0.1], [0, 1]], B: [[0.1]], G: [[0], [1]], C: [[1, 0]]}}"
)
LINES = {
    "wrong shape": (
        CONFIG.replace("start: {std: [1]}", "start: {std: [1, 2]}"),
        """\
noiseid.yaml:10:32: estimate.process_noise.start.std: has 2 entries, but the model has 1 process noise: v
      process_noise: {start: {std: [1, 2]}}
                                   ^
noiseid: a mistake in noiseid.yaml; nothing was done
""",
    ),
    "matrix of a wrong shape": (
        LINEAR,
        """\
noiseid.yaml:3:44: model.linear.B: B is 1 x 1, expected 2 x 1 (A is 2 x 2, C 1 x 2).
    model: {linear: {A: [[1, 0.1], [0, 1]], B: [[0.1]], G: [[0], [1]], C: [[1, 0]]}}
                                               ^
noiseid: a mistake in noiseid.yaml; nothing was done
""",
    ),
    "asymmetric R": (
        CONFIG.replace("{known: {std: [1e-3]}}", "{start: {full: [[1e-6, 1e-7], [2e-7, 1e-6]]}}"),
        """\
noiseid.yaml:11:53: estimate.measurement_noise.start.full.1.0: is not symmetric: entry (2, 1) is 2e-07, \
entry (1, 2) is 1e-07
      measurement_noise: {start: {full: [[1e-6, 1e-7], [2e-7, 1e-6]]}}
                                                        ^
noiseid: a mistake in noiseid.yaml; nothing was done
""",
    ),
    "a method that cannot": (
        CONFIG.replace("  methods:\n", "  parameters: {k: {start: 30}}\n  methods:\n"),
        """\
noiseid.yaml:17:9: estimate.methods.em: em cannot estimate what estimate.parameters asks for: give it as known, or \
take a method that can: ml, asrukf, sb-asrukf, batch-ml, recursive-ml
        em: {}
            ^
noiseid: a mistake in noiseid.yaml; nothing was done
""",
    ),
    "a class that is not there": (
        CONFIG.replace("class: Cart", "class: Card"),
        "noiseid: cart.py: there is no model class Card; it defines Cart.\n",
    ),
    "a model file that fails to import": (
        CONFIG.replace("cart.py", "broken.py"),
        "noiseid: broken.py:3: ModuleNotFoundError: No module named 'numpi'\n",
    ),
    "exact steps of what is not linear": (
        CONFIG.replace("cart.py, class: Cart}", "hanging.py, class: Hanging, discretisation: van_loan}"),
        """\
noiseid.yaml:3:59: model.discretisation: van_loan is for linear dynamics only; the rate of w is not linear: its slope \
in x depends on x: take rk4 or euler
    model: {file: hanging.py, class: Hanging, discretisation: van_loan}
                                                              ^
noiseid: a mistake in noiseid.yaml; nothing was done
""",
    ),
}


DOCUMENTED = (Path(__file__).parents[2] / "docs" / "mistakes.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("case", LINES)
def test_a_mistake_is_shown_with_its_place_and_what_is_allowed(tmp_path, monkeypatch, case):
    text, expected = LINES[case]
    file = write_experiment(tmp_path, text)
    (tmp_path / "broken.py").write_text('"""A model."""\n\nimport numpi\n')
    cart = (tmp_path / "cart.py").read_text()
    swinging = cart.replace("class Cart", "class Hanging").replace("p.k * x.x", "p.k * x.x**2")
    (tmp_path / "hanging.py").write_text(swinging)
    monkeypatch.setenv("COLUMNS", "300")
    ran = noiseid("run", file, "--out", tmp_path / "runs")
    assert ran.exit_code == 3
    assert ran.stderr.replace(f"{tmp_path}/", "").removeprefix("experiment: noiseid.yaml\n") == expected
    assert expected in DOCUMENTED
    assert ran.stdout == ""
    assert not (tmp_path / "runs").exists()


def test_an_unknown_column_is_named_with_those_that_are_there(tmp_path, monkeypatch):
    text = MEASURED.replace("    bad: {file: bad.csv}\n", "").replace("f: force", "f: forse")
    file = write_experiment(tmp_path, text)
    write_recordings(tmp_path)
    monkeypatch.setenv("COLUMNS", "300")
    ran = noiseid("run", file, "--out", tmp_path / "runs", "--jobs", "1", "--quiet")
    assert ran.exit_code == 3
    said = f"{tmp_path}/good.csv has no column 'forse'; it has 't', 'force', 'pos'. Did you mean 'force'?"
    assert said in ran.stderr
    assert said.replace(f"{tmp_path}/", "") in DOCUMENTED
    assert "Traceback" not in ran.output
