"""Where the misfit of a filter sits, in a result file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from noiseid_cli.diagnostics.where import Misfit
from noiseid_cli.storage.layout import add_index, get, put

if TYPE_CHECKING:
    import h5py


def fill_misfits(parent: h5py.Group, misfits: tuple[Misfit, ...]) -> None:
    """Write one group a quantity, in order."""
    parent = parent.create_group("misfit", track_order=True)
    for number, misfit in enumerate(misfits):
        group = parent.create_group(f"quantity_{number}")
        group.attrs["name"], group.attrs["unit"] = misfit.name, misfit.unit
        add_index(group, "border", len(misfit.edges), "border of the ranges")
        add_index(group, "range", len(misfit.nis), "range between two borders")
        put(group, "edges", misfit.edges, ("border",), misfit.unit or "1", f"borders of the ranges of {misfit.name}")
        put(group, "nis", misfit.nis, ("range",), "1", "mean normalised innovation squared per measurement")
        put(group, "counts", misfit.counts, ("range",), "1", "number of scalar measurements")


def read_misfits(parent: h5py.Group) -> tuple[Misfit, ...]:
    """What ``fill_misfits`` wrote; nothing in files from before there was any."""
    if "misfit" not in parent:
        return ()
    return tuple(
        Misfit(
            str(group.attrs["name"]),
            str(group.attrs["unit"]),
            *(get(group, name, (0,)) for name in ("edges", "nis", "counts")),
        )
        for group in parent["misfit"].values()
    )
