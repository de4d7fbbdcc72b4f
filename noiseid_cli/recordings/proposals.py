"""What to do about the faults that a log was found to have: a choice for each, and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from noiseid_cli.recordings.faults import counted
from noiseid_cli.recordings.survey import Survey
from noiseid_cli.recordings.table import Key
from noiseid_cli.recordings.time_column import TimeFound

_FEW = 0.1  # of the recorded rows: so many may be filled in without outputs


@dataclass(frozen=True)
class Proposal:
    """One entry of ``on_problem``.

    Attributes:
        problem: a field of ``ProblemPolicy``.
        choice: the value proposed.
        why: what was found, and what the choice does.
    """

    problem: str
    choice: str
    why: str


def propose(found: Survey, time: TimeFound, inputs: Sequence[Key], outputs: Sequence[Key]) -> tuple[Proposal, ...]:
    """A choice for each kind of fault that the log has; kinds that it has not are left at ``error``."""
    return tuple(
        proposal
        for proposal in (_non_number(found, time, inputs, outputs), _repeated(time), _backward(time), _gap(found, time),
                         _unequal(time))
        if proposal
    )  # fmt: skip


def _non_number(found: Survey, time: TimeFound, inputs: Sequence[Key], outputs: Sequence[Key]) -> Proposal | None:
    # An empty cell of an output is a missing value and no fault; time and inputs need a number in every row.
    needed = sum(found.column(key).bad + found.column(key).missing for key in inputs) + time.lost
    bad = sum(found.column(key).bad for key in outputs)
    if needed:
        why = f"{counted(needed, 'cell')} of the time or an input without a number: the rows are left out"
        return Proposal("non_number", "drop", why)
    if bad:
        return Proposal(
            "non_number", "mark_missing", f"{counted(bad, 'output cell')} without a number: taken as missing"
        )
    return None


def _repeated(time: TimeFound) -> Proposal | None:
    if not time.repeated:
        return None
    found = counted(time.repeated, "repeated time stamp")
    if time.agree:
        return Proposal("repeated_stamp", "drop", f"{found}; the rows are the same, so the second is left out")
    why = f"{found}, and the rows differ: one row is kept at that time, without outputs"
    return Proposal("repeated_stamp", "mark_missing", why)


def _backward(time: TimeFound) -> Proposal | None:
    if not time.backward:
        return None
    return Proposal("backward_stamp", "drop", f"{counted(time.backward, 'row')} earlier than one before: left out")


def _gap(found: Survey, time: TimeFound) -> Proposal | None:
    if not time.gaps:
        return None
    gaps = counted(time.gaps, "interval") + " above 3 times the usual one"
    if time.filled <= _FEW * len(found.table.row_numbers):
        return Proposal("gap", "mark_missing", f"{gaps}: filled with rows without outputs, the input held")
    return Proposal("gap", "split", f"{gaps}, too long to fill: a new test begins after each")


def _unequal(time: TimeFound) -> Proposal | None:
    if not time.unequal:
        return None
    why = f"{counted(time.unequal, 'interval')} off the usual one by more than 1 %: each step takes its own"
    return Proposal("unequal_interval", "keep", why)
