"""Eight numbers at once, in compiled code.

Rows of small matrices are too short for the compiler to make vector instructions of a loop over them: it neither knows
how many columns there are nor that two arrays do not overlap, and asks both before each loop. Blocks of eight columns
leave nothing to ask. A block is cut into what the processor has: one, two or four registers.

Each number of a block sees the same operations in the same order as in a loop, and no product is fused with a sum, so
that results do not depend on the processor.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.core.datamodel import models
from numba.extending import intrinsic as _intrinsic
from numba.extending import register_model

from noiseid_cli.models.jit import routine

EIGHT = np.uint64(8)
_BLOCK = ir.VectorType(ir.DoubleType(), 8)
_LANES = ir.VectorType(ir.IntType(32), 8)


intrinsic: Any = _intrinsic
"""Its type says that what it makes takes the compiler's arguments; in compiled code it takes ours."""


class _Eight(types.Type):
    """Eight float64, a value in registers."""

    def __init__(self) -> None:
        super().__init__(name="eight")


eight = _Eight()


@register_model(_Eight)
class _EightModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _BLOCK)  # type: ignore[no-untyped-call]


def _place(context: Any, builder: Any, kind: Any, A: Any, row: Any, column: Any) -> Any:
    """Where A[row, column] and the seven numbers after it stand."""
    array = context.make_array(kind)(context, builder, A)
    first = cgutils.get_item_pointer(context, builder, kind, array, [row, column])
    return builder.bitcast(first, _BLOCK.as_pointer())


def _all(builder: Any, number: Any) -> Any:
    """A block that holds one number eight times."""
    nothing = ir.Constant(_BLOCK, ir.Undefined)
    one = builder.insert_element(nothing, number, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(one, nothing, ir.Constant(_LANES, [0] * 8))


@intrinsic
def load(_, A, row, column):  # type: ignore[no-untyped-def]
    """A[row, column : column + 8]; the row must go on that far, which nobody checks."""

    def code(context, builder, signature, given):  # type: ignore[no-untyped-def]
        return builder.load(_place(context, builder, signature.args[0], *given), align=8)

    return eight(A, types.uint64, types.uint64), code


@intrinsic
def store(_, A, row, column, x):  # type: ignore[no-untyped-def]
    """A[row, column : column + 8] = x."""

    def code(context, builder, signature, given):  # type: ignore[no-untyped-def]
        builder.store(given[3], _place(context, builder, signature.args[0], *given[:3]), align=8)
        return context.get_dummy_value()

    return types.void(A, types.uint64, types.uint64, eight), code


@intrinsic
def zeros(_):  # type: ignore[no-untyped-def]
    """Eight times zero."""

    def code(context, builder, signature, given):  # type: ignore[no-untyped-def]
        return ir.Constant(_BLOCK, [0.0] * 8)

    return eight(), code


@intrinsic
def times(_, factor, x):  # type: ignore[no-untyped-def]
    """Product of a number and a block."""

    def code(context, builder, signature, given):  # type: ignore[no-untyped-def]
        return builder.fmul(_all(builder, given[0]), given[1])

    return eight(types.float64, eight), code


@intrinsic
def plus(_, x, factor, y):  # type: ignore[no-untyped-def]
    """Sum of the block x and ``factor`` times the block y."""

    def code(context, builder, signature, given):  # type: ignore[no-untyped-def]
        return builder.fadd(given[0], builder.fmul(_all(builder, given[1]), given[2]))

    return eight(eight, types.float64, eight), code


@routine
def blocks(columns):  # type: ignore[no-untyped-def]
    """The least multiple of eight that is at least ``columns``: the room that a row in blocks takes."""
    return (np.int64(columns) + 7) // 8 * 8


@routine
def rows_out(W, row, column, A):  # type: ignore[no-untyped-def]
    """Write the part of W from (row, column) on that is as large as A to A, whose rows are as long as they need be."""
    rows, width, row, column = np.uint64(A.shape[0]), np.uint64(A.shape[1]), np.uint64(row), np.uint64(column)
    for r in range(rows):
        c = np.uint64(0)
        # A block may go on into the rows of A that follow: they are written later.
        while c < width and r * width + c + EIGHT <= rows * width:
            store(A, r, c, load(W, row + r, column + c))
            c += EIGHT
        for k in range(c, width):
            A[r, k] = W[row + r, column + k]


@routine
def rows_in(A, W, row):  # type: ignore[no-untyped-def]
    """Write A to the first columns of W, whose rows are as long as blocks of A's; what follows is of no use."""
    rows, width, row = np.uint64(A.shape[0]), np.uint64(A.shape[1]), np.uint64(row)
    for r in range(rows):
        c = np.uint64(0)
        while c < width and r * width + c + EIGHT <= rows * width:
            store(W, row + r, c, load(A, r, c))
            c += EIGHT
        for k in range(c, width):
            W[row + r, k] = A[r, k]


@routine
def clear(W, row, column):  # type: ignore[no-untyped-def]
    """Set W[row, column:] to zero."""
    row, c, end = np.uint64(row), np.uint64(column), np.uint64(W.shape[1])
    while c + EIGHT <= end:
        store(W, row, c, zeros())
        c += EIGHT
    for k in range(c, end):
        W[row, k] = 0.0
