"""What a report is made of: results, and the facts about model, data and run that stand beside them."""

from __future__ import annotations

from dataclasses import dataclass, field

from noiseid_cli.models.recording import Array
from noiseid_cli.outcome import UnitResult


@dataclass(frozen=True)
class ParameterFact:
    """One parameter of the model.

    Attributes:
        name, unit, description: as the model gives them.
        value: the value in force.
        source: where it comes from; ``chosen`` for a value that has no source but our choice.
    """

    name: str
    value: float
    unit: str
    description: str
    source: str


@dataclass(frozen=True)
class EquationFact:
    """One equation of the model.

    Attributes:
        kind: ``definition``, ``dynamics``, ``output`` or ``performance``.
        text: the equation on one line.
        mathml: the same as presentation MathML, without the ``math`` element; empty where there is none.
    """

    kind: str
    text: str
    mathml: str = ""


@dataclass(frozen=True)
class ModelFacts:
    """The model in words: name, one sentence, its equations, its parameters."""

    name: str
    description: str
    equations: tuple[EquationFact, ...] = ()
    parameters: tuple[ParameterFact, ...] = ()


@dataclass(frozen=True)
class DatasetFacts:
    """One dataset in words and sizes.

    Attributes:
        name: as in ``UnitResult.dataset``.
        origin: ``simulated`` or ``imported``, with more words where useful.
        tests: number of tests.
        samples: number of samples of all tests.
        duration: length of all tests, s.
        missing_share: share of the scalar measurements that is missing, 0 to 1.
        notes: what was done to the data on the way in, in sentences.
        times: per test, (N,) time of each sample, s; empty if not known: figures then count samples.
        performance_unit: unit of the path error; empty where there is none.
        steps: quantisation step of each output by name, where the data show one.
        held: begin and end of a rest of the motion that the experiment asks for, s; None for none, or several tests.
    """

    name: str
    origin: str
    tests: int
    samples: int
    duration: float
    missing_share: float
    notes: tuple[str, ...] = ()
    times: tuple[Array, ...] = ()
    performance_unit: str = ""
    held: tuple[float, float] | None = None
    steps: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class PublishedFacts:
    """One published table.

    Attributes:
        name: stem of the table's files.
        title: what it shows.
        metric, index: our metric of the same thing, as in results.csv, taken at the estimate.
        unit: unit of the published figures, in words.
        rows: per statistic over the units of a method, the published figure by method label.
        note: what a reader must know to compare.
        source: where it is printed.
    """

    name: str
    title: str
    metric: str
    index: str
    unit: str
    rows: dict[str, dict[str, float]]
    note: str
    source: str


@dataclass(frozen=True)
class SweepFacts:
    """What was varied.

    Attributes:
        axes: name of each axis.
        settings: per axis, the settings that it varies, in words.
        values: per unit, the value of each axis; what is no number is text.
    """

    axes: tuple[str, ...]
    settings: tuple[str, ...]
    values: dict[str, tuple[float | int | str, ...]]


@dataclass(frozen=True)
class PublishedEstimates:
    """Published estimates of scalar unknowns.

    Attributes:
        title: where they stand.
        methods: by our method label and the name of the unknown, the estimate and its error, None where not printed.
        note: what a reader must know to compare.
        source: where they are printed.
    """

    title: str
    methods: dict[str, dict[str, tuple[float, float | None]]]
    note: str
    source: str


@dataclass(frozen=True)
class Study:
    """Everything that a report shows.

    Attributes:
        title: heading of the report.
        experiment: name of the experiment.
        results: one per unit, in the order in which they are shown.
        model: the model in words.
        datasets: the datasets in words.
        environment: name and version of whatever the numbers depend on.
        reproduce: lines to type to get the same results again.
        warnings: what a reader must know first, in sentences.
        citations: the papers behind the methods that ran.
        published: published tables that ours stand beside.
        claims: what their source claims, in sentences.
        estimates: published estimates of scalar unknowns; None where there are none.
        sweep: what was varied; None where nothing was.
        bounds: by method label, then by metric and index, the Cramer-Rao bound of a standard error, where it is exact.
    """

    title: str
    experiment: str
    results: list[UnitResult]
    model: ModelFacts
    datasets: list[DatasetFacts] = field(default_factory=list)
    environment: dict[str, str] = field(default_factory=dict)
    reproduce: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    citations: list[str] = field(default_factory=list)
    published: list[PublishedFacts] = field(default_factory=list)
    claims: list[str] = field(default_factory=list)
    estimates: PublishedEstimates | None = None
    sweep: SweepFacts | None = None
    bounds: dict[str, dict[tuple[str, str], float]] = field(default_factory=dict)

    def dataset(self, name: str) -> DatasetFacts | None:
        """Facts about one dataset; None where none were given."""
        return next((d for d in self.datasets if d.name == name), None)

    def chosen(self) -> str:
        """What a caption must say of values that nobody published; empty where there are none."""
        count = sum(p.source == "chosen" for p in self.model.parameters)
        verb = "is" if count == 1 else "are"
        return (
            f" {count} of {len(self.model.parameters)} model parameters {verb} chosen, not published." if count else ""
        )

    def path_unit(self) -> str:
        """Unit of the path error, where the datasets agree on one."""
        units = {d.performance_unit for d in self.datasets if d.performance_unit}
        return units.pop() if len(units) == 1 else ""
