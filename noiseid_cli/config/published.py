"""Published figures that a report sets beside ours: their file and its schema."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from noiseid_cli.config.base import Base, Label, Text
from noiseid_cli.config.yaml_loader import read_yaml
from noiseid_cli.errors import ConfigError

Statistic = Literal["max", "min", "mean", "median", "std"]


class PublishedTable(Base):
    """One published table: a statistic of one metric per row, a method per column."""

    title: Text = Field(description="what the table shows")
    metric: Text = Field(description="our metric of the same thing, as in results.csv")
    index: str = Field(default="", description="which entry of the metric, as in results.csv")
    unit: Text = Field(description="unit of the published figures")
    rows: Annotated[dict[Statistic, dict[Label, float]], Field(min_length=1)] = Field(
        description="statistic over the units of a method: {method label: published figure}"
    )
    note: Text | None = Field(default=None, description="what a reader must know to compare")


class PublishedValue(Base):
    """One published estimate."""

    value: float = Field(description="the estimate")
    error: float | None = Field(default=None, description="its standard error, where one is printed")


class PublishedEstimates(Base):
    """Published estimates of scalar unknowns, to stand beside ours of the same name."""

    title: Text = Field(description="where they stand, such as Table 1")
    methods: Annotated[dict[Label, dict[Text, PublishedValue]], Field(min_length=1)] = Field(
        description="method label: {unknown, as the report names it: published estimate}"
    )
    note: Text | None = Field(default=None, description="what a reader must know to compare")


class PublishedClaim(Base):
    """A claim of the source that was held against a run."""

    claim: Text = Field(description="the claim")
    found: Annotated[str, Field(min_length=1, max_length=1000)] = Field(
        description="what a run of the shipped experiment found, with its number of seeds"
    )


class Published(Base):
    """A file of published figures."""

    source: Text = Field(description="where they are printed")
    tables: dict[Label, PublishedTable] = Field(default={}, description="the tables")
    estimates: PublishedEstimates | None = Field(default=None, description="estimates of scalar unknowns")
    claims: tuple[Text | PublishedClaim, ...] = Field(
        default=(), strict=False, description="what the source claims, in sentences, alone or as {claim, found}"
    )


def load_published(path: Path) -> Published:
    """Read a file of published figures.

    Raises:
        DataError: the file cannot be read.
        ConfigError: with every mistake in it.
    """
    from noiseid_cli.config.messages import to_problem

    document = read_yaml(path)
    try:
        published = Published.model_validate(document.data)
    except ValidationError as error:
        found = [to_problem(entry, document) for entry in error.errors(include_url=False)]
        raise ConfigError(str(path), [*document.problems, *(p for p in found if p is not None)]) from None
    if document.problems:
        raise ConfigError(str(path), list(document.problems))
    return published
