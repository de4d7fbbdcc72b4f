"""Does a covariance fit the names it belongs to, and its structure?"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from noiseid_cli.config.covariance import Covariance, NoiseCovariance, smallest_eigenvalue
from noiseid_cli.config.document import Path
from noiseid_cli.config.schema_unknowns import Blocks, CovarianceChoice
from noiseid_cli.config.suggest import counted, did_you_mean

if TYPE_CHECKING:
    from noiseid_cli.models.recording import Array

Add = Callable[[Path, str], None]


def check_size(add: Add, path: Path, covariance: Covariance, names: Sequence[str], what: str) -> bool:
    """Compare the size of a covariance with the names it belongs to."""
    if covariance.size == len(names):
        return True
    has, wanted = counted(covariance.size, "entries"), counted(len(names), what)
    add((*path, covariance.form), f"has {has}, but the model has {wanted}: {', '.join(names)}")
    return False


def check_unit(add: Add, path: Path, covariance: NoiseCovariance | None, discretisation: str | None) -> None:
    """Refuse a density where the equations give the next state: nothing says how their noise goes with the interval."""
    if covariance is None:
        return
    if covariance.unit == "density" and discretisation == "discrete":
        add((*path, "unit"), "density goes with differential equations; this model is discrete: take per_sample")
    if covariance.unit == "per_sample" and discretisation == "van_loan":
        add(path, "the model is driven by white noise, whose covariance is a density: add `unit: density`")


def check_choice(add: Add, path: Path, choice: CovarianceChoice, names: Sequence[str], what: str) -> None:
    """Check a covariance of the ``estimate`` section, known or to be estimated."""
    if choice.known is not None:
        check_known(add, (*path, "known"), choice.known, names, what, path[-1] == "measurement_noise")
        return
    assert choice.start is not None  # the schema asks for one of the two
    known_names = _check_names(add, path, choice, names, what)
    if not check_size(add, (*path, "start"), choice.start, names, what) or not known_names:
        return
    here = (*path, "start", choice.start.form)
    matrix = choice.start.matrix()
    _check_structure(add, here, matrix, choice, names)
    for i, group in enumerate(choice.tied):
        variances = {float(matrix[names.index(name), names.index(name)]) for name in group}
        if len(variances) > 1:
            add((*path, "tied", i), f"{', '.join(group)} are tied, but start at different variances: give them one")
    _check_definite(add, here, matrix, names)


def check_known(
    add: Add, path: Path, known: Covariance, names: Sequence[str], what: str, definite: bool | None = None
) -> None:
    """Check a covariance that is taken as it is; a filter inverts that of the measurement noise."""
    must = path[-1] == "measurement_noise" if definite is None else definite
    if check_size(add, path, known, names, what) and must:
        _check_definite(add, (*path, known.form), known.matrix(), names)


def _check_names(add: Add, path: Path, choice: CovarianceChoice, names: Sequence[str], what: str) -> bool:
    """Check the names in ``structure``, ``fixed`` and ``tied``."""
    used: list[tuple[Path, str]] = []
    if isinstance(choice.structure, Blocks):
        for i, block in enumerate(choice.structure.blocks):
            used += [((*path, "structure", "blocks", i, j), name) for j, name in enumerate(block)]
    for i, entry in enumerate(choice.fixed):
        if isinstance(entry, str):
            used.append(((*path, "fixed", i), entry))
        else:
            used += [((*path, "fixed", i, j), name) for j, name in enumerate(entry)]
    for i, group in enumerate(choice.tied):
        used += [((*path, "tied", i, j), name) for j, name in enumerate(group)]
    unknown = [(place, name) for place, name in used if name not in names]
    for place, name in unknown:
        add(place, f"{name} is not one of the model's {what}: {', '.join(names)}{did_you_mean(name, names)}")
    return not unknown


def _check_structure(add: Add, path: Path, matrix: Array, choice: CovarianceChoice, names: Sequence[str]) -> None:
    """Refuse a start with covariances that its structure does not have."""
    if choice.structure in ("full", "scale"):
        return
    blocks = choice.structure.blocks if isinstance(choice.structure, Blocks) else ()
    block_of = {name: i for i, block in enumerate(blocks) for name in block}
    for i, first in enumerate(names):
        for j, second in enumerate(names[:i]):
            together = first in block_of and block_of[first] == block_of.get(second)
            if matrix[i, j] != 0.0 and not together:
                add(path, f"has a covariance of {second} and {first}, which the structure holds at 0")
                return


def _check_definite(add: Add, path: Path, matrix: Array, names: Sequence[str]) -> None:
    """Refuse a singular matrix: a filter inverts R, and no method leaves a start of zero variance."""
    import numpy as np

    zero = [i for i in range(len(names)) if matrix[i, i] == 0.0]
    for i in zero:
        place = (i, i) if path[-1] == "full" else (i,)
        add((*path, *place), f"the variance of {names[i]} must not be 0: give a positive value")
    if zero:
        return
    smallest, direction = smallest_eigenvalue(matrix)
    if smallest <= len(names) ** 2 * np.finfo(np.float64).eps:
        mix = ", ".join(f"{name} {part:.3g}" for name, part in zip(names, direction, strict=True))
        add(path, f"must be positive definite; it is singular in the direction {mix} (at unit variances)")
