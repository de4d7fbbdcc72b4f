"""Faults of a recording: collected with their rows, told all at once, or noted with what was done about them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from noiseid_cli.errors import DataError

_LISTED = 20
_CHOICES = {
    "non_number": "drop (leaves the row out) or mark_missing (an output without a value; inputs and time need one)",
    "repeated_stamp": "drop (keeps the first row) or mark_missing (keeps one row, without outputs)",
    "backward_stamp": "drop (leaves the row out)",
    "gap": "mark_missing (fills with rows without outputs, input held) or split (begins a new test)",
    "unequal_interval": "keep (each interval as it is) or resample (to equal ones; interpolation colours the noise)",
}


@dataclass(frozen=True)
class Fault:
    """One fault: its kind (a field of ``ProblemPolicy``), where it stands, and what it is."""

    kind: str
    file: Path
    where: str
    text: str


@dataclass
class Findings:
    """What was found in the recordings of one dataset: faults that stop the import, and notes on the others."""

    faults: list[Fault] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def raise_if_faulty(self, dataset: str) -> None:
        """Tell all faults in one error.

        Raises:
            DataError: there is at least one.
        """
        if not self.faults:
            return
        counts = Counter(fault.kind for fault in self.faults)
        share = max(_LISTED // len(counts), 1)
        files = len({fault.file for fault in self.faults})
        lines = [f"Dataset '{dataset}': {counted(len(self.faults), 'fault')} in {counted(files, 'recording')}."]
        for kind, count in counts.items():
            listed = [fault for fault in self.faults if fault.kind == kind][:share]
            lines += [f"  {fault.file}, {fault.where}: {fault.text}" for fault in listed]
            if count > len(listed):
                lines.append(f"  and {count - len(listed)} more of this kind")
        lines.append("Mend the file, or choose in the config under import.on_problem:")
        lines += [f"  {kind}: {_CHOICES[kind]}" for kind in counts]
        raise DataError("\n".join(lines))


def counted(count: int, noun: str) -> str:
    """``1 row``, ``2 rows``."""
    return f"{count} {noun}" + ("" if count == 1 else "s")


def places(word: str, numbers: Sequence[int]) -> str:
    """``line 4`` or ``lines 4, 9, 11 and 7 more``."""
    listed = ", ".join(str(int(number)) for number in numbers[:5])
    more = f" and {len(numbers) - 5} more" if len(numbers) > 5 else ""
    return f"{word}{'' if len(numbers) == 1 else 's'} {listed}{more}"
