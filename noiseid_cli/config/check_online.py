"""Do the tables of the online filters name the unknowns, all of them where a value is needed?"""

from __future__ import annotations

from collections.abc import Sequence

from noiseid_cli.config.document import Path
from noiseid_cli.config.findings import Findings
from noiseid_cli.config.methods_online import JointSrukfOptions, OnlineOptions
from noiseid_cli.config.schema_estimate import Estimate
from noiseid_cli.config.suggest import did_you_mean


def check_online(findings: Findings, estimate: Estimate, noises: Sequence[str]) -> None:
    """Check the tables of each online filter.

    Args:
        findings: takes the complaints.
        estimate: the experiment's ``estimate`` section.
        noises: names of the model's process noises.
    """
    for label, options in estimate.methods.items():
        if not isinstance(options, OnlineOptions):
            continue
        here: Path = ("estimate", "methods", label)
        names = _unknowns(estimate, noises, options)
        for table, needed in (("parameter_covariance", True), ("parameter_noise", True), ("thresholds", False)):
            allowed = tuple(estimate.parameters) if table == "thresholds" else names
            given = getattr(options, table, None)
            if given is None:
                continue
            for name in given:
                if name not in allowed:
                    known = ", ".join(allowed) or "none"
                    text = f"{name} is not estimated here; what this table may name: {known}"
                    findings.add((*here, table, name), text + did_you_mean(name, allowed))
            if needed and (missing := [name for name in names if name not in given]):
                findings.add((*here, table), f"has no entry for {', '.join(missing)}: give each unknown a variance")


def _unknowns(estimate: Estimate, noises: Sequence[str], options: OnlineOptions) -> tuple[str, ...]:
    """Names of what one method estimates."""
    choice, parameters = estimate.process_noise, tuple(estimate.parameters)
    if choice.start is None or isinstance(options, JointSrukfOptions):
        return parameters
    return (*(name for name in noises if name not in choice.fixed), *parameters)
