"""What a kernel needs at every call, handed over once: a compiled record that Python holds by reference.

Each array, and above all each function, that goes from Python into a kernel costs up to some microseconds. A filter
that runs sample by sample hands over its functions and its arrays once, and then the record only.
"""

from __future__ import annotations

from typing import Any

from numba import types
from numba.core import cgutils
from numba.experimental import structref
from numba.extending import intrinsic


@structref.register
class HandleType(types.StructRef):
    """Type of a handle. Its class has a name in a module because the cache of kernels looks it up by that."""


class Handle(structref.StructRefProxy):
    """A handle as Python sees it: something to be passed on."""

    __slots__ = ()


structref.define_boxing(HandleType, Handle)


new: Any = structref.new
"""In a kernel: an empty handle of a type, whose fields are then assigned one by one."""


def handle_type(**fields: Any) -> Any:
    """The type of a handle, from the numba types of its fields."""
    return HandleType(list(fields.items()))  # type: ignore[no-untyped-call]


def _uncounted(context: Any, builder: Any, kinds: Any, arrays: Any) -> Any:
    """The tuple with its arrays' counts of references taken out of them."""
    for i, kind in enumerate(kinds):
        array = cgutils.create_struct_proxy(kind)(context, builder, value=builder.extract_value(arrays, i))
        array.meminfo = cgutils.get_null_value(array.meminfo.type)
        array.parent = cgutils.get_null_value(array.parent.type)
        arrays = builder.insert_value(arrays, array._getvalue(), i)
    return arrays


def _borrowed(typing_context: Any, arrays: Any) -> Any:
    """The same tuple of arrays, which no longer count their references.

    Each slice of an array counts one reference up and down, in atomic steps that cost more than the arithmetic on a
    small matrix. A kernel may borrow what its caller holds until it returns; it must not return or keep it.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _uncounted(context, builder, signature.args[0], args[0])

    return arrays(arrays), generate


borrowed: Any = intrinsic(_borrowed)


def _workspace_of(typing_context: Any, handle: Any) -> Any:
    """The handle's field ``workspace``, a tuple of arrays, borrowed.

    A routine takes the handle and asks for this: a tuple of many arrays as an argument is copied at each call, word by
    word, of which there are eight an array.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        fields = structref._Utils(context, builder, signature.args[0]).get_data_struct(args[0])
        return _uncounted(context, builder, signature.return_type, fields.workspace)

    return handle.field_dict["workspace"](handle), generate


workspace_of: Any = intrinsic(_workspace_of)
