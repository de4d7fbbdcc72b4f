"""Tables, figures and pages made from results."""

from noiseid_cli.report.page import FORMATS, ReportFiles, make_report
from noiseid_cli.report.study import (
    DatasetFacts,
    EquationFact,
    ModelFacts,
    ParameterFact,
    PublishedEstimates,
    PublishedFacts,
    Study,
    SweepFacts,
)
from noiseid_cli.report.summary import terminal_tables

__all__ = [
    "FORMATS",
    "DatasetFacts",
    "EquationFact",
    "ModelFacts",
    "ParameterFact",
    "PublishedEstimates",
    "PublishedFacts",
    "ReportFiles",
    "Study",
    "SweepFacts",
    "make_report",
    "terminal_tables",
]
