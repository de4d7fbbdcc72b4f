"""The kinds of value that the schema is made of: closed, finite, never converted in silence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, NoReturn

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, Strict
from pydantic_core import PydanticCustomError

LABEL = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$"


class Base(BaseModel):
    """A mapping with a closed set of settings; true is not a number, nor is the text "1"."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


def refuse(message: str, at: Sequence[str | int] = ()) -> NoReturn:
    """Complain from within a validator.

    Args:
        message: what is wrong and what is allowed.
        at: the setting at fault, seen from the mapping under validation.
    """
    # The text is handed over as a value: pydantic would read braces in a template as fields.
    raise PydanticCustomError("refused", "{message}", {"message": message, "at": tuple(at)})


def refuse_order(lowest: float, highest: float) -> None:
    """Refuse bounds of which the upper one, ``highest``, is not above the lower one."""
    if highest <= lowest:
        refuse(f"must be above lowest, {lowest:g}, not {highest:g}", at=["highest"])


def _whole(value: Any) -> Any:
    """Take 4e3 for 4000, but leave 0.5 to be refused."""
    if isinstance(value, float) and abs(value) <= 2.0**53 and value.is_integer():
        return int(value)
    return value


def unique(names: Sequence[str]) -> str | None:
    """Give the first name that differs from an earlier one by nothing or by upper and lower case only."""
    seen: set[str] = set()
    for name in names:
        if name.casefold() in seen:
            return name
        seen.add(name.casefold())
    return None


Whole = Annotated[int, BeforeValidator(_whole)]
WholeFrom0 = Annotated[int, Field(ge=0), BeforeValidator(_whole)]
WholeFrom2 = Annotated[int, Field(ge=2), BeforeValidator(_whole)]
Count = Annotated[int, Field(ge=1), BeforeValidator(_whole)]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Text = Annotated[str, Field(min_length=1, max_length=500)]
Label = Annotated[str, Field(pattern=LABEL)]

# A YAML list becomes a tuple: the outer conversion is allowed, each entry stays strict.
Numbers = Annotated[tuple[float, ...], Strict(False), Field(min_length=1)]
Positives = Annotated[tuple[Positive, ...], Strict(False), Field(min_length=1)]
NotNegatives = Annotated[tuple[NotNegative, ...], Strict(False), Field(min_length=1)]
Matrix = Annotated[tuple[Numbers, ...], Strict(False), Field(min_length=1)]
Names = Annotated[tuple[Text, ...], Strict(False), Field(min_length=1)]
