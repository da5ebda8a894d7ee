"""Operations on vectors of 16 float32 lanes, emitted as LLVM instructions for the loops over blocks."""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba.core import cgutils

LANES = 16
FLOAT, INT, LONG = ir.FloatType(), ir.IntType(32), ir.IntType(64)
VECTOR, INTS = ir.VectorType(FLOAT, LANES), ir.VectorType(INT, LANES)
MASK = ir.IntType(LANES)  # one bit per lane

# 2^f on [-1/2, 1/2]: the minimax polynomial of degree 5, with a relative error of 7.6e-8 in exact arithmetic.
POWER = (
    1.0000000720325866, 0.6931469780529467, 0.24022118496605865, 0.05550695276973524, 0.009675590659164249,
    0.00132822976697421,
)  # fmt: skip
MAGIC = 12582912.0  # 1.5 * 2^23: adding it rounds to an integer, which then stands in the lowest bits


class Lanes:
    """Vector operations, appended to one IR builder."""

    def __init__(self, builder: ir.IRBuilder) -> None:
        self.b = builder
        kind = ir.FunctionType(VECTOR, [VECTOR] * 3)
        self._fma = cgutils.get_or_insert_function(builder.module, kind, "llvm.fma.v16f32")

    def constant(self, values: float | list[float]) -> ir.Constant:
        """A vector of one value, or of 16."""
        lanes = values if isinstance(values, list) else [values] * LANES
        return ir.Constant(VECTOR, [ir.Constant(FLOAT, float(np.float32(v))) for v in lanes])

    def integer(self, value: int) -> ir.Constant:
        """A vector of one int32."""
        return ir.Constant(INTS, [ir.Constant(INT, value)] * LANES)

    def spread(self, scalar: ir.Value) -> ir.Value:
        """Broadcast a float32 to all lanes."""
        undefined = ir.Constant(VECTOR, ir.Undefined)
        first = self.b.insert_element(undefined, scalar, ir.Constant(INT, 0))
        return self.b.shuffle_vector(first, undefined, self.integer(0))

    def fma(self, x: ir.Value, y: ir.Value, z: ir.Value) -> ir.Value:
        """x y + z, rounded once."""
        return self.b.call(self._fma, [x, y, z])

    def minus(self, x: ir.Value) -> ir.Value:
        return self.b.fneg(x)

    def negative(self, x: ir.Value) -> ir.Value:
        """Lanes whose sign bit is set, negative zeros included."""
        return self.b.icmp_signed("<", self.b.bitcast(x, INTS), self.integer(0))

    def power_of_two(self, q: ir.Value) -> ir.Value:
        """2^q for -125 <= q < 127, undefined elsewhere: a polynomial of the fraction, its exponent increased."""
        b = self.b
        shifted = b.fadd(q, self.constant(MAGIC))
        fraction = b.fsub(q, b.fsub(shifted, self.constant(MAGIC)))
        value = self.constant(POWER[-1])
        for coefficient in POWER[-2::-1]:
            value = self.fma(value, fraction, self.constant(coefficient))
        exponent = b.shl(b.bitcast(shifted, INTS), self.integer(23))
        return b.bitcast(b.add(b.bitcast(value, INTS), exponent), VECTOR)

    def load(self, pointer: ir.Value) -> ir.Value:
        """16 floats from a pointer aligned to 4 bytes."""
        value = self.b.load(self.b.bitcast(pointer, VECTOR.as_pointer()))
        value.align = 4
        return value

    def store(self, value: ir.Value, pointer: ir.Value) -> None:
        """16 floats to a pointer aligned to 4 bytes."""
        self.b.store(value, self.b.bitcast(pointer, VECTOR.as_pointer())).align = 4

    def largest(self, vectors: list[ir.Value]) -> ir.Value:
        """The maximum over all lanes of non-negative vectors, whose bits compare like unsigned integers."""
        b = self.b
        most = vectors[0]
        for vector in vectors[1:]:
            most = b.select(b.fcmp_ordered(">", vector, most), vector, most)
        kind = ir.FunctionType(INT, [INTS])
        reduce = cgutils.get_or_insert_function(b.module, kind, "llvm.vector.reduce.umax.v16i32")
        return b.bitcast(b.call(reduce, [b.bitcast(most, INTS)]), FLOAT)

    def total(self, vectors: list[ir.Value]) -> ir.Value:
        """The sum of all lanes by pairwise halving: a fixed order, so that rounding is the same on all processors."""
        b = self.b
        while len(vectors) > 1:
            vectors = [b.fadd(x, y) for x, y in zip(vectors[::2], vectors[1::2], strict=True)]
        (left,), count = vectors, LANES
        while count > 1:
            count //= 2
            kind = ir.VectorType(INT, count)
            low, high = (ir.Constant(kind, [ir.Constant(INT, start + n) for n in range(count)]) for start in (0, count))
            left = b.fadd(b.shuffle_vector(left, left, low), b.shuffle_vector(left, left, high))
        return b.extract_element(left, ir.Constant(INT, 0))

    def count_set(self, masks: list[ir.Value]) -> ir.Value:
        """The number of true lanes in all masks."""
        b = self.b
        kind = ir.FunctionType(MASK, [MASK])
        count = cgutils.get_or_insert_function(b.module, kind, f"llvm.ctpop.i{LANES}")
        total = ir.Constant(LONG, 0)
        for mask in masks:
            total = b.add(total, b.zext(b.call(count, [b.bitcast(mask, MASK)]), LONG))
        return total
