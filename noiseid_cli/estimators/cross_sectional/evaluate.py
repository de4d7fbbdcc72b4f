"""Evaluate tests at a theta, by the partitioned method or by the full one."""

from __future__ import annotations

from typing import Literal

import numpy as np

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.cross_sectional.correlated import correlated
from noiseid_cli.estimators.cross_sectional.equal import EqualTests, equal_tests
from noiseid_cli.estimators.cross_sectional.full import full_evaluation
from noiseid_cli.estimators.cross_sectional.ignorant import Statistics, ignorant_filter, statistics
from noiseid_cli.estimators.cross_sectional.information import Evaluation, evaluate_statistics
from noiseid_cli.estimators.cross_sectional.problem import Coordinates, CrossSection, Theta
from noiseid_cli.estimators.cross_sectional.restoring import restored_information
from noiseid_cli.models.recording import Array
from noiseid_cli.models.threads import in_threads

Evaluator = Literal["partitioned", "full"]


def partitioned(tests: CrossSection, theta: Theta, coordinates: Coordinates) -> tuple[Evaluation, Statistics]:
    """Natural (mu, Sigma, alpha) evaluation of each test, and the statistics that it came from.

    Tests that share their covariances go through one filter.
    """
    na, nb = coordinates.na, coordinates.nb
    gathered, blocks = Statistics.empty(len(tests), na, nb), np.empty((len(tests), na, na))

    def run(some: EqualTests) -> tuple[Statistics, Array]:
        found = ignorant_filter(some.matrices, some.recordings, some.T)
        return statistics(found), restored_information(found, theta.mu, theta.Sigma)

    groups = equal_tests(tests, theta.alpha)
    for some, (found, information) in zip(groups, in_threads(run, groups), strict=True):
        gathered.put(some.which, found)
        blocks[some.which] = information
    return evaluate_statistics(gathered, theta.mu, theta.Sigma, coordinates, blocks), gathered


def full(tests: CrossSection, theta: Theta, coordinates: Coordinates) -> Evaluation:
    """The same by the differentiated standard filter; its information is (30) throughout."""
    results = [
        full_evaluation(tests.matrices(i, theta.alpha), recording, T, theta, coordinates)
        for i, (recording, T) in enumerate(zip(tests.recordings, tests.maps, strict=True))
    ]
    nll, gradient, information = zip(*results, strict=True)
    return Evaluation(np.array(nll), np.array(gradient), np.array(information))


def evaluate(
    tests: CrossSection, theta: Theta, coordinates: Coordinates, evaluator: Evaluator = "partitioned"
) -> Evaluation:
    """Evaluation of each test in the coordinates (log alpha where they say so); given those before, where correlated.

    Raises:
        EstimationError: a filter fails, or ``full`` is asked of correlated tests.
    """
    if tests.common is not None:
        if evaluator == "full":
            raise EstimationError("tests with a common bias are evaluated by the partitioned method only")
        natural = correlated(tests, theta, coordinates)[0]
    elif evaluator == "full":
        natural = full(tests, theta, coordinates)
    else:
        natural = partitioned(tests, theta, coordinates)[0]
    return in_coordinates(natural, theta, coordinates)


def in_coordinates(natural: Evaluation, theta: Theta, coordinates: Coordinates) -> Evaluation:
    """Chain rule from natural (mu, Sigma, alpha) to the coordinates."""
    slopes = coordinates.slopes(theta)
    return Evaluation(natural.nll, natural.gradient * slopes, natural.information * np.outer(slopes, slopes))
