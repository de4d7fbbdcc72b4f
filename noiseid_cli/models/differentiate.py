"""Straight-line programs and their exact derivatives by forward accumulation.

A program is a list of statements ``symbol = expression`` and the expressions of its results. Common
subexpressions are shared first; then each statement is differentiated once with respect to the symbols that it
reads and the chain rule is written out as further statements, skipping structural zeros (Griewank & Walther,
Evaluating Derivatives, 2008, ch. 3.2). Code grows with the number of statements times the seeds they depend on.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sympy as sp


@dataclass(frozen=True)
class Program:
    """Statements in an order in which each reads only inputs and earlier statements, and results."""

    statements: tuple[tuple[Any, Any], ...]
    results: tuple[Any, ...]


def share(definitions: Mapping[Any, Any], results: Sequence[Any], names: Iterator[Any]) -> Program:
    """Program that computes results with every common subexpression computed once.

    Args:
        definitions: expressions of symbols that the results and each other use, without cycles.
        results: expressions.
        names: supplies new symbols for the shared subexpressions.
    """
    used = _reachable(definitions, results)
    found, reduced = sp.cse([*(definitions[s] for s in used), *results], symbols=names, order="none")
    statements = dict(found) | dict(zip(used, reduced, strict=False))
    results = reduced[len(used) :]
    return Program(tuple((s, statements[s]) for s in _reachable(statements, results)), tuple(results))


def _reachable(definitions: Mapping[Any, Any], results: Iterable[Any]) -> list[Any]:
    """The defined symbols that results depend on, each after those it reads itself."""
    order: dict[Any, None] = {}
    opened: set[Any] = set()
    stack = [(s, False) for e in reversed(list(results)) for s in _reads(e, definitions)]
    while stack:
        s, done = stack.pop()
        if done:
            order[s] = None
        elif s not in opened:
            opened.add(s)
            stack.append((s, True))
            stack.extend((r, False) for r in _reads(definitions[s], definitions))
    return list(order)


def _reads(expression: Any, definitions: Mapping[Any, Any]) -> list[Any]:
    return sorted(expression.free_symbols & definitions.keys(), key=str)


def differentiate(program: Program, seeds: Sequence[Any], names: Iterator[Any]) -> tuple[Program, list[list[Any]]]:
    """Extend a program by the derivatives of its results.

    Args:
        program: the values.
        seeds: input symbols to differentiate by.
        names: supplies new symbols.

    Returns:
        The extended program with the same results, and the derivative of each result by each seed: a symbol
        or a number.
    """
    tangents: dict[Any, dict[Any, Any]] = {s: {s: sp.Integer(1)} for s in seeds}
    statements: list[tuple[Any, Any]] = []

    def chain(expression: Any) -> dict[Any, Any]:
        row: dict[Any, Any] = {}
        for s in sorted(expression.free_symbols & tangents.keys(), key=str):
            local = sp.diff(expression, s)
            if local == 0:
                continue
            for seed, inner in tangents[s].items():
                row[seed] = row.get(seed, 0) + local * inner
        return {seed: _named(total) for seed, total in row.items() if total != 0}

    def _named(total: Any) -> Any:
        if total.is_Atom:
            return total
        name = next(names)
        statements.append((name, total))
        return name

    for s, expression in program.statements:
        statements.append((s, expression))
        row = chain(expression)
        if row:
            tangents[s] = row
    rows = [chain(e) for e in program.results]
    partials = [[row.get(seed, sp.Integer(0)) for seed in seeds] for row in rows]
    return Program(tuple(statements), program.results), partials


def pull_back(
    program: Program, weights: Sequence[Any], groups: Sequence[Sequence[Any]], names: Iterator[Any]
) -> tuple[Program, list[list[Any]]]:
    """Derivatives of the weighted sum of a program's results, by reverse accumulation (Griewank & Walther, ch. 3.3).

    The code grows with the number of statements, whatever the number of inputs. A jump (of sign, Heaviside and the
    like) has slope 0: the derivative holds wherever there is one.

    Args:
        program: the values.
        weights: one symbol for each result.
        groups: input symbols to differentiate by, in groups.
        names: supplies new symbols.

    Returns:
        A program whose results are those derivatives in one row, and the same in a list for each group.
    """
    active = {s for group in groups for s in group}
    for s, expression in program.statements:
        if expression.free_symbols & active:
            active.add(s)
    terms: dict[Any, list[Any]] = {}
    added: list[tuple[Any, Any]] = []

    def spread(expression: Any, weight: Any) -> None:
        for s in sorted(expression.free_symbols & active, key=str):
            local = sp.diff(expression, s).replace(sp.DiracDelta, lambda *_: sp.Integer(0))
            if local != 0:
                terms.setdefault(s, []).append(weight * local)

    for expression, weight in zip(program.results, weights, strict=True):
        spread(expression, weight)
    for s, expression in reversed(program.statements):
        if s in terms:
            name = next(names)
            added.append((name, sp.Add(*terms.pop(s))))
            spread(expression, name)
    flat = [sp.Add(*terms.get(s, [])) for group in groups for s in group]
    shared = share(dict([*program.statements, *added]), flat, names)
    entries = iter(shared.results)
    return shared, [[next(entries) for _ in group] for group in groups]


def fix(program: Program, symbols: Iterable[Any], value: int = 0) -> Program:
    """The program with some inputs set to a constant."""
    constants = dict.fromkeys(symbols, sp.Integer(value))
    if not constants:
        return program
    return Program(
        tuple((s, e.xreplace(constants)) for s, e in program.statements),
        tuple(e.xreplace(constants) for e in program.results),
    )
