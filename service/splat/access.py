"""Intrinsics for the kernels: unchecked flat array access, maximum and minimum, rounding, prefetch, atomic add.

Numba's own indexing unpacks an array's seven fields and allows for negative indices at every access, and its min, max
and ceil are function calls. These are one or two instructions each: the kernels compile in 80 % of the time, and LLVM
can vectorise their loops.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.extending import intrinsic

BLOCK = 256  # Gaussians that `prepare.py` keeps together, field by field


def typed(function: Callable) -> Any:
    """`numba.extending.intrinsic` without its type stub, which counts the typing context among the call's arguments."""
    return intrinsic(function)


def data_of(context, b: ir.IRBuilder, kind: types.Array, array: ir.Value) -> ir.Value:
    """The pointer to an array's first element."""
    return b.extract_value(array, context.data_model_manager[kind].get_field_position("data"))


def _require_rows(array: types.Array) -> None:
    """Refuse an array that is not C-contiguous: strides are ignored below."""
    if array.layout != "C":
        raise TypingError(f"an array in layout {array.layout}, need C order")


@typed
def get(typing, array, index):
    """The element at the flat `index` of a C-contiguous array, 0 <= index < size; unchecked."""
    _require_rows(array)

    def generate(context, b, signature, arguments):
        data = data_of(context, b, signature.args[0], arguments[0])
        return b.load(b.gep(data, [arguments[1]], inbounds=True))

    return array.dtype(array, types.int64), generate


@typed
def put(typing, array, index, value):
    """Store `value` at the flat `index`, as `get` reads it; unchecked."""
    _require_rows(array)

    def generate(context, b, signature, arguments):
        kind = signature.args[0]
        value = context.cast(b, arguments[2], signature.args[2], kind.dtype)
        b.store(value, b.gep(data_of(context, b, kind, arguments[0]), [arguments[1]], inbounds=True))
        return context.get_dummy_value()

    return types.void(array, types.int64, value), generate


@typed
def get_field(typing, array, at, field):
    """The element at + field * BLOCK: one field of one Gaussian in a block that is stored field by field."""
    _require_rows(array)

    def generate(context, b, signature, arguments):
        return b.load(_field(context, b, signature, arguments))

    return array.dtype(array, types.int64, types.int64), generate


@typed
def put_field(typing, array, at, field, value):
    """Store what `get_field` reads."""
    _require_rows(array)

    def generate(context, b, signature, arguments):
        value = context.cast(b, arguments[3], signature.args[3], signature.args[0].dtype)
        b.store(value, _field(context, b, signature, arguments))
        return context.get_dummy_value()

    return types.void(array, types.int64, types.int64, value), generate


def _field(context, b, signature, arguments):
    array, at, field = arguments[:3]
    index = b.add(at, b.mul(field, ir.Constant(ir.IntType(64), BLOCK)))
    return b.gep(data_of(context, b, signature.args[0], array), [index], inbounds=True)


def _choice(symbol: str) -> Any:
    def choose(typing, a, b):
        kind = typing.unify_types(a, b)

        def generate(context, builder, signature, arguments):
            x, y = (context.cast(builder, v, t, kind) for v, t in zip(arguments, signature.args, strict=True))
            if isinstance(kind, types.Float):
                return builder.select(builder.fcmp_ordered(symbol, x, y), x, y)
            return builder.select(builder.icmp_signed(symbol, x, y), x, y)

        return kind(a, b), generate

    return typed(choose)


larger = _choice(">")  # both give the second argument where one is NaN
smaller = _choice("<")


def _rounding(name: str) -> Any:
    def round_to(typing, x):
        def generate(context, b, signature, arguments):
            double = ir.DoubleType()
            function = cgutils.get_or_insert_function(b.module, ir.FunctionType(double, [double]), f"llvm.{name}.f64")
            return b.call(function, arguments)

        return types.float64(types.float64), generate

    return typed(round_to)


round_up = _rounding("ceil")
round_down = _rounding("floor")


@typed
def prefetch(typing, array, index):
    """Prefetch the cache line of the flat `index`, which may lie outside the array."""

    def generate(context, b, signature, arguments):
        data = data_of(context, b, signature.args[0], arguments[0])
        pointer = b.bitcast(b.gep(data, [arguments[1]]), ir.IntType(8).as_pointer())
        kind = ir.FunctionType(ir.VoidType(), [ir.IntType(8).as_pointer(), *[ir.IntType(32)] * 3])
        function = cgutils.get_or_insert_function(b.module, kind, "llvm.prefetch.p0")
        b.call(function, [pointer, *(ir.Constant(ir.IntType(32), value) for value in (0, 3, 1))])
        return context.get_dummy_value()

    return types.void(array, types.int64), generate


@typed
def take(typing, counter, amount):
    """Atomically add `amount` to counter[0] and return its previous value."""
    _require_rows(counter)

    def generate(context, b, signature, arguments):
        data = data_of(context, b, signature.args[0], arguments[0])
        return b.atomic_rmw("add", data, arguments[1], "monotonic")

    return types.int64(counter, types.int64), generate
