"""Which column of a log is which input or output of a model, told by their names."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from noiseid_cli.errors import DataError
from noiseid_cli.recordings.roles import kind_of, label_of
from noiseid_cli.recordings.survey import Survey
from noiseid_cli.recordings.table import Key
from noiseid_cli.recordings.time_column import words_of


def match_columns(
    word: str, names: Sequence[str], found: Survey, free: Iterable[Key], given: Mapping[str, Key]
) -> dict[str, Key]:
    """The column of each input or output of a model.

    A column matches by its whole name, else by what its name speaks of (a torque, an angle) and its number, else
    if all words of the quantity's name are in it; and only if no other column does.

    Args:
        word: ``input`` or ``output``, for messages.
        names: the model's.
        found: the log.
        free: columns that may be taken, in the order of the file.
        given: what the user has said, by the model's name.

    Raises:
        DataError: a name of the user's is not the model's, or a quantity has no column or several.
    """
    if strangers := [name for name in given if name not in names]:
        raise DataError(f"the model has no {word} {strangers[0]!r}; it has {', '.join(names) or 'none'}")
    left = [key for key in free if key not in given.values()]
    matched: dict[str, Key] = {}
    for name in names:
        matched[name] = given[name] if name in given else _only(word, name, found, left)
        if matched[name] in left:
            left.remove(matched[name])
    return matched


def _only(word: str, name: str, found: Survey, left: Sequence[Key]) -> Key:
    same = [key for key in left if isinstance(key, str) and key.rpartition("/")[2].lower() == name.lower()]
    kin = [key for key in left if kind_of(name) and (kind_of(key), label_of(key)) == (kind_of(name), label_of(name))]
    holding = [key for key in left if set(words_of(name)) <= set(words_of(key))]
    for candidates in (same, kin, holding):
        if len(candidates) == 1:
            return candidates[0]
        if candidates:
            break
    several = f"columns {', '.join(map(str, candidates))} could all be" if candidates else "no column looks like"
    flag = f"--{word} {name}=COLUMN"
    raise DataError(
        f"{found.source.file}: {several} the model's {word} {name}. Say which one is, with {flag}; the columns are "
        + ", ".join(str(column.key) for column in found.columns)
    )
