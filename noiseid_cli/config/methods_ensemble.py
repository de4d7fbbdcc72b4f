"""Options of the methods for ensembles of tests."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, Strict

from noiseid_cli.config.base import Count, NotNegative, Positive, WholeFrom2
from noiseid_cli.config.method_base import MethodOptions


class BatchMlOptions(MethodOptions):
    """Maximum likelihood over all tests of an ensemble at once, by scoring."""

    summary: ClassVar[str] = "maximum likelihood over an ensemble of tests at once, by scoring"
    estimates: ClassVar[str] = (
        "m0 and P0 (full, diagonal) of the ensemble; model parameters and variances of Q and R of a linear model, "
        "variances of Q and R of a nonlinear one"
    )
    citation: ClassVar[str] = (
        "D. W. Porter, M. D. Shuster, B. P. Gibbs, W. S. Levine: A partitioned recursive algorithm for the estimation "
        "of dynamical and initial-condition parameters from cross-sectional data, 22nd IEEE Conference on Decision and "
        "Control, 1983"
    )
    can: ClassVar[frozenset[str]] = frozenset({"Q", "R", "m0", "P0", "parameters"})
    structures: ClassVar[frozenset[str]] = frozenset({"diagonal", "fixed"})

    method: Literal["batch-ml"] = Field(
        default="batch-ml", description="batch maximum likelihood; default: the label it stands under"
    )
    evaluator: Literal["partitioned", "full"] = Field(
        default="partitioned",
        description="partitioned: a filter ignorant of the first state, and what it tells about it; full: the "
        "differentiated standard filter, slower, same likelihood",
    )
    tolerance: Positive = Field(
        default=1e-10, description="Newton decrement g' H^-1 g of the log-likelihood below which it is at its maximum"
    )
    max_iterations: Count = Field(default=100, description="largest number of scoring steps")
    at_tests: Annotated[tuple[WholeFrom2, ...], Strict(False)] = Field(
        default=(), description="numbers of first tests at which an estimate is made too, to hold a recursion against"
    )


class RecursiveMlOptions(MethodOptions):
    """Maximum likelihood test by test: each is used once, and an estimate goes on when new tests come."""

    summary: ClassVar[str] = "maximum likelihood test by test, continued when new tests come (--continue)"
    estimates: ClassVar[str] = BatchMlOptions.estimates
    citation: ClassVar[str] = BatchMlOptions.citation
    can: ClassVar[frozenset[str]] = BatchMlOptions.can
    structures: ClassVar[frozenset[str]] = BatchMlOptions.structures

    method: Literal["recursive-ml"] = Field(
        default="recursive-ml", description="recursive maximum likelihood; default: the label it stands under"
    )
    scheme: Literal["statistics", "refresh", "literal"] = Field(
        default="statistics",
        description="literal is the published recursion; refresh and statistics keep a few numbers of each test and "
        "are as efficient as batch-ml in the covariance of the first state",
    )
    first: WholeFrom2 = Field(
        default=5, description="number of tests of the batch estimate that the recursion starts from"
    )
    gain_exponent: Annotated[float, Field(gt=0.5, le=1)] = Field(
        default=1.0, description="the gain at test i is i to the minus gain_exponent; 1 is the published one"
    )
    delta: Annotated[NotNegative, Field(le=1e-6)] = Field(
        default=0.0, description="share of its own first diagonal that is added to the information at each test"
    )
