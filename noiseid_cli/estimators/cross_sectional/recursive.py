"""Recursive maximum likelihood: each test is used once (porter1983_partitioned_recursive, eq. 13, 14).

    R(i) = R(i-1) + gamma(i) (H_i + delta D - R(i-1)),   theta(i) = theta(i-1) - gamma(i) R(i)^-1 dl_i

H_i and dl_i are taken at theta(i-1); R is updated first. R(n0) is the mean information of the first n0 tests at their
batch estimate, D its diagonal. In the ``literal`` scheme R averages informations at old estimates, which for Sigma is
inefficient and reports too small errors. Two schemes beyond the paper cure it, keeping nb^2 + nb numbers of each test:
``refresh`` rebuilds the beta block of R at the present theta, ``statistics`` solves beta over all kept (J, j) anew.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from noiseid_cli.errors import EstimationError
from noiseid_cli.estimators.cross_sectional.admissible import boundary, project
from noiseid_cli.estimators.cross_sectional.batch import BatchOptions, batch_ml
from noiseid_cli.estimators.cross_sectional.correlated import Carried, correlated
from noiseid_cli.estimators.cross_sectional.evaluate import in_coordinates, partitioned
from noiseid_cli.estimators.cross_sectional.information import beta_blocks, restore
from noiseid_cli.estimators.cross_sectional.problem import Coordinates, CrossSection, Theta
from noiseid_cli.estimators.cross_sectional.recursive_state import RecursiveOptions, RecursiveState
from noiseid_cli.estimators.cross_sectional.scoring import score, solve_positive
from noiseid_cli.models.recording import Array

MIN_FIRST = 2


def recursive_ml(
    tests: CrossSection, start: Theta, coordinates: Coordinates, options: RecursiveOptions | None = None
) -> RecursiveState:
    """Batch over the first tests, then the recursion over the others.

    Args:
        tests: the cross-section, in the order of use.
        start: where the batch run begins.
        coordinates: which entries of Sigma are free, and whether alpha is positive.
        options: see ``RecursiveOptions``.

    Raises:
        EstimationError: fewer tests than ``first``, the batch start fails, or the information is not positive definite.
    """
    options = options or RecursiveOptions()
    state = start_recursion(tests.select(slice(options.first)), start, coordinates, options)
    return continue_recursion(state, tests.select(slice(options.first, None))) if len(tests) > options.first else state


def start_recursion(
    tests: CrossSection, start: Theta, coordinates: Coordinates, options: RecursiveOptions | None = None
) -> RecursiveState:
    """The state after a batch run over all of ``tests``.

    Raises:
        EstimationError: fewer tests than ``options.first`` or than two, or the batch run fails or does not converge.
    """
    options = options or RecursiveOptions()
    n, keeps = len(tests), options.scheme != "literal"
    if keeps and tests.common is not None:
        raise EstimationError(f"scheme {options.scheme!r} is for independent tests; with a common bias take literal")
    if n < max(options.first, MIN_FIRST):
        raise EstimationError(
            f"the recursion starts from a batch of {max(options.first, MIN_FIRST)} tests, but there are {n}: "
            "record more, or start from fewer (at least two, since one test always gives a zero Sigma)"
        )
    batch = batch_ml(tests, start, coordinates, BatchOptions())
    if not batch.converged:
        raise EstimationError(f"the batch start did not converge: {batch.scored.reason}")
    R, p, nb = batch.scored.information / n, coordinates.size, coordinates.nb
    J, j, carried = np.empty((0, nb, nb)), np.empty((0, nb)), Carried.before_all(None, p)
    if tests.common is not None:
        _, carried = correlated(tests, batch.theta, coordinates)
    if keeps:
        _, s = partitioned(tests, batch.theta, coordinates)
        J, j = s.gram[:, 1:, 1:].copy(), s.gram[:, 1:, 0].copy()
    return RecursiveState(
        options=options,
        coordinates=coordinates,
        vector=coordinates.pack(batch.theta),
        information=R,
        metric=np.diag(R).copy(),
        delta_share=0.0,
        count=n,
        squared_weights=1.0 / n,
        J=J,
        j=j,
        weights=np.full(len(J), 1.0 / n),
        carried=carried,
        history=coordinates.pack(batch.theta)[None],
        history_errors=batch.standard_errors[None],
        projected_tests=np.empty(0, dtype=np.int64),
        projected_from=np.empty((0, p)),
        boundary_start=boundary(batch.theta, batch.scored.information, coordinates),
    )


def continue_recursion(state: RecursiveState, tests: CrossSection) -> RecursiveState:
    """Take in new tests one by one; the old ones are not needed.

    Raises:
        EstimationError: the tests do not fit the state, a filter fails, or R is not positive definite.
    """
    if tests.nb != state.coordinates.nb:
        raise EstimationError(f"the state is for {state.coordinates.nb} components of b, the new tests have {tests.nb}")
    shared = 0 if tests.common is None else len(tests.common.first)
    if shared != len(state.carried.mean):
        raise EstimationError(
            f"the state carries {len(state.carried.mean)} components of a common bias, the new tests have {shared}"
        )
    for i in range(len(tests)):
        state = _take_in(state, tests.select(slice(i, i + 1)))
    return state


def _take_in(state: RecursiveState, test: CrossSection) -> RecursiveState:
    """One step of (13), (14) with one test."""
    coordinates, options = state.coordinates, state.options
    i = state.count + 1
    gamma = float(i) ** -options.gain_exponent
    state, gradient = _learn(state, test, gamma)
    R = state.information + options.delta * state.delta_share * np.diag(state.metric)
    moved = state.vector - gamma * solve_positive(R, gradient)  # (13)
    with np.errstate(over="ignore"):
        theta = coordinates.unpack(moved)
    if not np.all(np.isfinite(theta.alpha)) or (coordinates.log_alpha and not np.all(theta.alpha > 0.0)):
        raise EstimationError(
            f"test {test.recordings[0].name!r} moves alpha out of the numbers that can be written: "
            "start from a batch of more tests"
        )
    if options.scheme == "statistics":
        after, projected = _solve_beta(state, theta.alpha), False
    else:
        after = project(theta, state.information, coordinates)
        projected = after is not theta
    state = replace(
        state,
        vector=coordinates.pack(after),
        information=state.information if options.scheme == "literal" else _refreshed(state, after),
        count=i,
        squared_weights=(1.0 - gamma) ** 2 * state.squared_weights + gamma**2,
        projected_tests=np.append(state.projected_tests, [i] * projected).astype(np.int64),
        projected_from=np.concatenate((state.projected_from, moved[None][: int(projected)])),
    )
    return replace(
        state,
        history=np.concatenate((state.history, state.vector[None])),
        history_errors=np.concatenate((state.history_errors, state.standard_errors[None])),
    )


def _learn(state: RecursiveState, test: CrossSection, gamma: float) -> tuple[RecursiveState, Array]:
    """Take a test's information into R (14) and keep its statistics; theta stays. Also returns dl_i."""
    theta, coordinates = state.theta, state.coordinates
    if test.common is None:
        natural, s = partitioned(test, theta, coordinates)
        if state.options.scheme != "literal":
            state = replace(
                state,
                J=np.concatenate((state.J, s.gram[:, 1:, 1:])),
                j=np.concatenate((state.j, s.gram[:, 1:, 0])),
                weights=np.append((1.0 - gamma) * state.weights, gamma),
            )
    else:
        natural, carried = correlated(test, theta, coordinates, state.carried)
        state = replace(state, carried=carried)
    e = in_coordinates(natural, theta, coordinates)
    state = replace(
        state,
        information=state.information + gamma * (e.information[0] - state.information),  # (14)
        delta_share=state.delta_share + gamma * (1.0 - state.delta_share),
    )
    if state.options.scheme != "literal":
        state = replace(state, information=_refreshed(state, theta))
    return state, e.gradient[0]


def _refreshed(state: RecursiveState, theta: Theta) -> Array:
    """R with its beta block rebuilt from the kept J at the present Sigma, each test with the weight gamma gave it."""
    _, blocks = beta_blocks(restore(state.J, state.j, theta.mu, theta.Sigma), state.coordinates)
    n = state.coordinates.n_beta
    R = state.information.copy()
    R[:n, :n] = np.einsum("t,tmn->mn", state.weights, blocks)
    return R


def _solve_beta(state: RecursiveState, alpha: Array) -> Theta:
    """The mu and Sigma of greatest likelihood given the kept statistics of all tests."""
    coordinates, before = replace(state.coordinates, na=0), state.theta

    def objective(beta: Theta) -> tuple[float, Array, Array]:
        b = restore(state.J, state.j, beta.mu, beta.Sigma)
        gradient, information = beta_blocks(b, coordinates)
        w = state.weights / np.sum(np.square(state.weights))  # as a sum over tests, not a mean
        return float(w @ b.nll), w @ gradient, np.einsum("t,tmn->mn", w, information)

    beta = score(objective, Theta(before.mu, before.Sigma, np.empty(0)), coordinates).theta
    return Theta(beta.mu, beta.Sigma, alpha)
