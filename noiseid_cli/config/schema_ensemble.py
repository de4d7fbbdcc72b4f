"""What an ensemble of tests has beside its noise: the map of the first state, a bias that tests share, which tests."""

from __future__ import annotations

from typing import Self

from pydantic import ConfigDict, Field, model_validator

from noiseid_cli.config.base import Base, Count, Matrix, Names, Text, refuse
from noiseid_cli.config.covariance import Covariance


class InitialMap(Base):
    """The first state is T b and what the model gives of it; b has the initial mean and covariance."""

    model_config = ConfigDict(json_schema_extra={"oneOf": [{"required": ["matrix"]}, {"required": ["tests"]}]})

    names: Names = Field(description="names of the components of b")
    matrix: Matrix | None = Field(default=None, description="T: a row for each state, a column for each component of b")
    tests: dict[Text, Matrix] | None = Field(default=None, description="T of each test, by the test's name")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.matrix is None) == (self.tests is None):
            refuse("give either matrix (the same for all tests) or tests (one for each)")
        return self


class CommonBias(Base):
    """A bias of outputs that tests share, such as that of one instrument: constant, or a random walk over tests."""

    outputs: Names = Field(description="the outputs that have one")
    first: Covariance = Field(description="covariance of the bias in the first test; its mean is 0")
    walk: Covariance | None = Field(
        default=None, description="covariance of its change from test to test; default: constant"
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        for name in ("first", "walk"):
            value = getattr(self, name)
            if value is not None and value.size != len(self.outputs):
                refuse(f"has {value.size} entries for {len(self.outputs)} outputs", at=[name])
        return self


class TestRange(Base):
    """Which tests of a dataset are used, counted from 1."""

    first: Count = Field(default=1, description="the first one")
    last: Count | None = Field(default=None, description="the last one; default: all that follow")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.last is not None and self.last < self.first:
            refuse(f"must be at least first, {self.first}, not {self.last}", at=["last"])
        return self
