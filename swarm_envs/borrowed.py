"""Named tuples that kernels take by their address.

Numba passes a named tuple as all that it holds, one argument each: six hundred for a world of sixty
arrays, at every call. To compile that took half of the time, and to take sixty arrays apart for
each call from Python a few microseconds. `Borrowed` is the type of such a tuple's address; its
fields are read as those of the tuple. Kernels borrow from each other, and from Python by `lend`.
"""

from __future__ import annotations

import ctypes
import hashlib
from functools import cache
from typing import Any, TypeVar

import numba
import numpy as np
from llvmlite import ir
from numba.core import cgutils
from numba.core import types as numba_types
from numba.core.codegen import JITCPUCodegen
from numba.core.imputils import impl_ret_borrowed
from numba.core.types.containers import BaseNamedTuple
from numba.core.types.misc import unliteral
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    NativeValue,
    infer_getattr,
    lower_cast,
    lower_getattr_generic,
    models,
    register_model,
    typeof_impl,
    unbox,
)

T = TypeVar("T", bound=tuple[Any, ...])

types: Any = numba_types  # its names are assembled at run time
"""Numba's types, whose names are assembled at run time."""

SUPPORTED = hasattr(JITCPUCodegen, "_pass_builder")
"""Whether this numba has the insides that borrowing, and `swarm_envs.lowering`, are built on. With
another, kernels are compiled as numba does it: the same results, but slower to compile and call."""


class Borrowed(types.Type):  # type: ignore[misc]  # numba is untyped
    """Type of the address of a named tuple, valid while the function that it is handed to runs."""

    def __init__(self, lent: Any) -> None:
        self.lent = lent
        digest = hashlib.sha256(str(lent).encode()).hexdigest()[:16]
        super().__init__(f"Borrowed({lent.instance_class.__name__}.{digest})")


@cache
def _borrowed(lent: Any) -> Borrowed:
    return Borrowed(lent)


def borrow(argument: Any) -> Any:
    """The type by which an argument of this type is handed to a kernel."""
    argument = unliteral(argument)
    return _borrowed(argument) if isinstance(argument, BaseNamedTuple) else argument


@register_model(Borrowed)
class _BorrowedModel(models.PrimitiveModel):  # type: ignore[misc]  # numba is untyped
    def __init__(self, manager: Any, borrowed: Borrowed) -> None:
        lent = manager.lookup(borrowed.lent).get_value_type()
        super().__init__(manager, borrowed, lent.as_pointer())


@infer_getattr
class _BorrowedFields(AttributeTemplate):  # type: ignore[misc]  # numba is untyped
    key = Borrowed

    def generic_resolve(self, borrowed: Borrowed, name: str) -> Any:
        """Type of a field; a tuple in a tuple is borrowed too."""
        if name not in borrowed.lent.fields:
            return None
        return borrow(borrowed.lent.types[borrowed.lent.fields.index(name)])


@lower_getattr_generic(Borrowed)  # type: ignore[untyped-decorator]
def _read_field(context: Any, builder: Any, borrowed: Borrowed, address: Any, name: str) -> Any:
    place = borrowed.lent.fields.index(name)
    kind = borrow(borrowed.lent.types[place])
    field = cgutils.gep_inbounds(builder, address, 0, place)
    if isinstance(kind, Borrowed):
        return field
    return impl_ret_borrowed(context, builder, kind, builder.load(field))


@lower_cast(BaseNamedTuple, Borrowed)  # type: ignore[untyped-decorator]
def _lend_value(context: Any, builder: Any, lent: Any, borrowed: Borrowed, value: Any) -> Any:
    return cgutils.alloca_once_value(builder, value)


_KNOWN = ir.values.ArgumentAttributes._known
_KEPT_NOWHERE = "captures(none)" if "captures(none)" in _KNOWN else "nocapture"
"""LLVM's word for an address that is not kept: it has changed."""


def mark_borrowed(module: ir.Module) -> None:
    """Tell LLVM that what is borrowed is neither written nor kept, so that it is read once."""
    for function in module.functions:
        for argument in function.args[2:]:  # after the places of the result and of an exception
            kind = argument.type
            if isinstance(kind, ir.PointerType) and isinstance(kind.pointee, ir.LiteralStructType):
                argument.add_attribute("noalias")
                argument.add_attribute(_KEPT_NOWHERE)


class _Lent(int):
    """The address of a named tuple's copy in the layout that kernels read, which it keeps alive."""

    memory: ctypes.Structure
    lent: tuple[Any, ...]
    kind: Borrowed


def lend(lent: T) -> T:
    """What a kernel takes in place of a named tuple that never changes, if its arrays may.

    Only kernels can read it. It keeps the tuple alive, and the call need not look at it.
    """
    if numba.config.DISABLE_JIT or not SUPPORTED:
        return lent
    memory = _memory(lent)
    address: Any = _Lent(ctypes.addressof(memory))
    address.memory, address.lent, address.kind = memory, lent, borrow(numba.typeof(lent))
    stand_in: T = address
    return stand_in


def _memory(value: Any) -> Any:
    """The value as numba's data model lays it out."""
    if isinstance(value, tuple):
        parts = [_memory(part) for part in value]
    elif isinstance(value, np.ndarray):
        parts = [ctypes.c_void_p(), ctypes.c_void_p()]  # no owner: `_Lent` keeps it alive
        parts += [ctypes.c_int64(value.size), ctypes.c_int64(value.itemsize)]
        parts += [ctypes.c_void_p(value.ctypes.data)]
        parts += [ctypes.c_int64(number) for number in value.shape + value.strides]
    else:
        return _SCALARS[numba.typeof(value)](value)
    layout = [(f"field_{k}", type(part)) for k, part in enumerate(parts)]
    return type("Memory", (ctypes.Structure,), {"_fields_": layout})(*parts)


_SCALARS = {
    types.boolean: ctypes.c_bool,
    types.int64: ctypes.c_int64,
    types.float64: ctypes.c_double,
}


@typeof_impl.register(_Lent)  # type: ignore[untyped-decorator]
def _typeof_lent(lent: _Lent, context: Any) -> Borrowed:
    return lent.kind


@unbox(Borrowed)  # type: ignore[untyped-decorator]
def _unbox_lent(borrowed: Borrowed, lent: Any, c: Any) -> NativeValue:
    address = c.pyapi.long_as_voidptr(lent)
    return NativeValue(c.builder.bitcast(address, c.context.get_value_type(borrowed)))
