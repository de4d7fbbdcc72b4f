"""Problems without a good answer, and one way to put each before every method, from dataset file to result file."""

from pathlib import Path

import numpy as np

from noiseid_cli.models.recording import Dataset, Recording
from noiseid_cli.pipeline.context import open_experiment
from noiseid_cli.pipeline.engine import run_units
from noiseid_cli.pipeline.units import dataset_units, estimate_units
from noiseid_cli.storage.dataset_file import write_dataset

METHODS = ("em", "ml", "alg2", "alg3", "asrukf", "joint-srukf", "batch-ml", "recursive-ml")
RNG = np.random.default_rng(0)
N, TESTS = 30, 6
WALKS = [np.cumsum(RNG.normal(size=(N, 1)), axis=0) + RNG.normal(size=(N, 1)) for _ in range(TESTS)]


def each(change):
    """The same change to every test."""
    return [change(y.copy()) for y in WALKS]


def outlier(y):
    y[N // 2] = 1e8
    return y


DATA = {
    "one sample": each(lambda y: y[:1]),
    "two samples": each(lambda y: y[:2]),
    "all missing": each(lambda y: y * np.nan),
    "one test all missing": [WALKS[0] * np.nan, *WALKS[1:]],
    "constant": each(lambda y: y * 0 + 3.0),
    "zero": each(lambda y: y * 0.0),
    "equal tests": [WALKS[0]] * TESTS,
    "outlier": each(outlier),
    "1e150": each(lambda y: y * 1e150),
    "1e-160": each(lambda y: y * 1e-160),
    "infinite": each(lambda y: y * np.inf),
}
"""The outputs of each test, for the one-state model."""

PATH = '''
from noiseid_cli.models import Model, Parameter, Quantity


class Level(Model):
    """A level that is measured; alg2 minimises the error of a performance output, which matrices have not."""

    name = "level"
    states = (Quantity("x1"),)
    noises = (Quantity("v1"),)
    outputs = (Quantity("y1"),)
    performances = (Quantity("z1"),)
    parameters = (Parameter("a", 0.9),)
    sample_time = 1.0
    discretisation = "discrete"

    def dynamics(self, x, u, v, p):
        return [p.a * x.x1 + v.v1]

    def output(self, x, u, p):
        return [x.x1]

    def performance(self, x, u, p):
        return [x.x1]
'''
ONE = "{linear: {A: [[a]], C: [[1]], discretisation: discrete, sample_time: 1}, parameters: {a: 0.9}}"
UNOBSERVABLE = (
    "{linear: {A: [[a, 0], [0, 0.5]], C: [[1, 0]], discretisation: discrete, sample_time: 1}, parameters: {a: 0.9}}"
)
TWICE = "{linear: {A: [[a]], C: [[1], [1]], discretisation: discrete, sample_time: 1}, parameters: {a: 0.9}}"
MODELS = {
    "Q0 = 1e-300": {"q": [1e-150]},
    "Q0 = 0": {"q": [0.0]},
    "R = 0": {"r": [0.0]},
    "R = 1e-300": {"r": [1e-150]},
    "P0 = 0": {"p": [0.0]},
    "P0 = 1e16": {"p": [1e8]},
    "unobservable": {"model": UNOBSERVABLE, "q": [1.0, 1.0], "p": [1.0, 1.0]},
    "unstable": {"model": ONE.replace("0.9", "3.0")},
    "unstable beyond all numbers": {"model": ONE.replace("0.9", "1e200")},
    "duplicated outputs": {"model": TWICE, "r": [1.0, 1.0]},
}
"""What is changed in the experiment, with the walks as data."""


def experiment(method, model=ONE, q=(1.0,), r=(1.0,), p=(1.0,)):
    """The experiment file for one method."""
    q, r, p = map(list, (q, r, p))
    parameter = model[model.rindex("a: ") + 3 : model.rindex("}}")]
    if method == "alg2" and "linear" in model:
        model = f"{{file: level.py, class: Level, parameters: {{a: {parameter}}}}}"
    ensemble = method in ("batch-ml", "recursive-ml")
    estimated = method in ("ml", "joint-srukf", "asrukf")
    parameters = f"  parameters: {{a: {{start: {parameter}}}}}\n" if estimated else ""
    known_q = method in ("joint-srukf", "batch-ml", "recursive-ml")
    known_r = method not in ("em", "ml")
    law = "start" if ensemble else "known"
    outputs = ", ".join(f"y{k + 1}: y" for k in range(len(r)))
    options = {
        "em": "{max_passes: 30}",
        "ml": "{}",
        "asrukf": "{parameter_covariance: {a: 0.1, NOISES}}",
        "joint-srukf": "{parameter_covariance: {a: 0.1}, parameter_noise: {a: 1e-6}}",
        "recursive-ml": "{first: 3}",
    }.get(method, "{}")
    options = options.replace("NOISES", ", ".join(f"v{k + 1}: 0.1" for k in range(len(q))))
    return f"""\
experiment: degenerate
model: {model}
import:
  recordings: {{log: {{file: log.csv}}, other: {{file: log.csv}}}}
  time: {{column: t}}
  outputs: {{{outputs}}}
estimate:
  process_noise: {{{"known" if known_q else "start"}: {{std: {q}}}{"" if known_q else ", structure: diagonal"}}}
  measurement_noise: {{{"known" if known_r else "start"}: {{std: {r}}}{"" if known_r else ", structure: diagonal"}}}
  initial_mean: {{{law}: {[0.0] * len(p)}}}
  initial_covariance: {{{law}: {{std: {p}}}{", structure: diagonal" if ensemble else ""}}}
{parameters}  methods:
    {method}: {options}
"""


class Silent:
    """A listener that heeds nothing."""

    def __getattr__(self, _):
        return lambda *_: None


def outcome(folder: Path, method: str, outputs=None, **changes):
    """The token of one estimate: everything from a dataset file to a result file has run, or has said why not."""
    outputs = WALKS if outputs is None else outputs
    file = folder / "degenerate.yaml"
    file.write_text(experiment(method, **changes))
    (folder / "level.py").write_text(PATH)
    (folder / "log.csv").write_text("t,y\n0,0\n1,0\n")
    context = open_experiment(file, folder)
    model = context.model
    groups = (model.states, model.outputs, model.performances)
    columns = [tuple((q.name, q.unit, q.description) for q in group) for group in groups]
    width, true = len(columns[1]), len(columns[0])
    tests = [
        Recording(
            f"t{k}",
            np.ones(max(len(y) - 1, 0)),
            np.zeros((len(y), 0)),
            np.tile(y, (1, width)),
            0.0,
            np.tile(WALKS[k][: len(y)], (1, true)),
            WALKS[k][: len(y)] if model.performances else None,
        )
        for k, y in enumerate(outputs)
    ]
    unit = dataset_units(context)[0]
    named = {"states": columns[0], "outputs": columns[1], "performances": columns[2]}
    dataset = Dataset("degenerate", model.name, tuple(tests), **named)
    write_dataset(unit.path, dataset, {})
    (token,) = run_units(context, "estimate", estimate_units(context), Silent())
    return token
