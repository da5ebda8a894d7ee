"""The innermost loop of blending as explicit 16-lane vectors: one list of Gaussians over one block of 8 x 8 pixels.

Written in LLVM's own instructions, since no loop that a compiler vectorises keeps a block's transmittance and colours
in registers: four vectors hold its 64 pixels (two rows of 8 each), times the channels. LLVM splits the vectors where a
processor's are shorter. `reference.py` says the same in float64, and tests compare them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

LANES = 16
SIDE = 8  # px of a block
VECTORS = SIDE * SIDE // LANES
ROWS = LANES // SIDE  # of a block in one vector
CHANNELS = 5  # transmittance, red, green, blue, depth
BLOCK_STATE = CHANNELS * SIDE * SIDE  # floats
CHECK = 8  # Gaussians between two looks whether all pixels of the block are finished, a power of two

# What a list's entry holds of its Gaussian, relative to the tile's centre: one cache line.
U1, STEP1, U2, SHEAR2, STEP2, LOG_OPACITY, RED, GREEN, BLUE, DEPTH, CUT = range(11)
ENTRY = 16  # floats

# 2^f on [-1/2, 1/2]: the polynomial of degree 5 of least relative error, 7.6e-8 in exact arithmetic.
POWER = (
    1.0000000720325866, 0.6931469780529467, 0.24022118496605865, 0.05550695276973524, 0.009675590659164249,
    0.00132822976697421,
)  # fmt: skip
MAGIC = 12582912.0  # 1.5 * 2^23: adding it rounds to an integer, which then stands in the lowest bits

_FLOAT, _INT, _LONG, _BYTE = ir.FloatType(), ir.IntType(32), ir.IntType(64), ir.IntType(8)
_VECTOR, _INTS = ir.VectorType(_FLOAT, LANES), ir.VectorType(_INT, LANES)


class _Lanes:
    """The few vector operations that the loop needs, on one builder."""

    def __init__(self, builder: ir.IRBuilder) -> None:
        self.b = builder
        kind = ir.FunctionType(_VECTOR, [_VECTOR] * 3)
        self._fma = cgutils.get_or_insert_function(builder.module, kind, "llvm.fma.v16f32")

    def constant(self, values: float | list[float]) -> ir.Constant:
        lanes = values if isinstance(values, list) else [values] * LANES
        return ir.Constant(_VECTOR, [ir.Constant(_FLOAT, float(np.float32(v))) for v in lanes])

    def integer(self, value: int) -> ir.Constant:
        return ir.Constant(_INTS, [ir.Constant(_INT, value)] * LANES)

    def spread(self, scalar: ir.Value) -> ir.Value:
        undefined = ir.Constant(_VECTOR, ir.Undefined)
        first = self.b.insert_element(undefined, scalar, ir.Constant(_INT, 0))
        return self.b.shuffle_vector(first, undefined, self.integer(0))

    def fma(self, x: ir.Value, y: ir.Value, z: ir.Value) -> ir.Value:
        """x y + z, rounded once."""
        return self.b.call(self._fma, [x, y, z])

    def minus(self, x: ir.Value) -> ir.Value:
        return self.b.fneg(x)

    def power_of_two(self, q: ir.Value) -> ir.Value:
        """2^q for -125 <= q < 127, anything elsewhere: the fraction by a polynomial, the rest into the exponent."""
        b = self.b
        shifted = b.fadd(q, self.constant(MAGIC))
        fraction = b.fsub(q, b.fsub(shifted, self.constant(MAGIC)))
        value = self.constant(POWER[-1])
        for coefficient in POWER[-2::-1]:
            value = self.fma(value, fraction, self.constant(coefficient))
        exponent = b.shl(b.bitcast(shifted, _INTS), self.integer(23))
        return b.bitcast(b.add(b.bitcast(value, _INTS), exponent), _VECTOR)

    def load(self, pointer: ir.Value) -> ir.Value:
        value = self.b.load(self.b.bitcast(pointer, _VECTOR.as_pointer()))
        value.align = 4
        return value

    def store(self, value: ir.Value, pointer: ir.Value) -> None:
        self.b.store(value, self.b.bitcast(pointer, _VECTOR.as_pointer())).align = 4


def _blend_one(lanes: _Lanes, entry: ir.Value, x: ir.Value, y: list[ir.Value], cuts: list[ir.Value],
               state: list[list[ir.Value]], channels: int, inclusive: bool) -> None:  # fmt: skip
    """Add one entry to the block whose channels lie in the stack slots `state[channel][vector]`.

    All vectors go through each step together: their chains of dependent operations then overlap.
    """
    b, each = lanes.b, range(VECTORS)
    alpha_max, stop = cuts

    def field(index: int) -> ir.Value:
        return lanes.spread(b.load(b.gep(entry, [ir.Constant(_LONG, index)])))

    across = lanes.fma(x, field(STEP1), field(U1))
    level = lanes.fma(lanes.minus(across), across, field(LOG_OPACITY))
    start = lanes.fma(lanes.minus(x), field(SHEAR2), field(U2))
    step = field(STEP2)
    down = [lanes.fma(y[j], step, start) for j in each]
    power = [lanes.fma(lanes.minus(down[j]), down[j], level) for j in each]
    cut = field(CUT)
    seen = [b.fcmp_ordered(">=", power[j], cut) for j in each]
    alpha = [lanes.power_of_two(power[j]) for j in each]
    alpha = [b.select(b.fcmp_ordered("<", a, alpha_max), a, alpha_max) for a in alpha]
    light = [b.load(state[0][j]) for j in each]
    none = lanes.constant(0.0)
    if inclusive:
        counts = [b.and_(seen[j], b.fcmp_ordered(">", light[j], stop)) for j in each]
        weight = [b.select(counts[j], b.fmul(alpha[j], light[j]), none) for j in each]
        left = [b.fsub(light[j], weight[j]) for j in each]
    else:  # a pixel that the Gaussian would finish is finished without it: its light stays, with a minus sign
        weight = [b.select(seen[j], b.fmul(alpha[j], light[j]), none) for j in each]
        left = [b.fsub(light[j], weight[j]) for j in each]
        goes_on = [b.fcmp_ordered(">=", left[j], stop) for j in each]
        weight = [b.select(goes_on[j], weight[j], none) for j in each]
        finished = [b.select(b.fcmp_ordered(">", light[j], none), lanes.minus(light[j]), light[j]) for j in each]
        left = [b.select(goes_on[j], left[j], finished[j]) for j in each]
    for j in each:
        b.store(left[j], state[0][j])
    for channel in range(1, channels):
        shade = field(RED + channel - 1)
        for j in each:
            b.store(lanes.fma(weight[j], shade, b.load(state[channel][j])), state[channel][j])


def _block_loop(channels: int, inclusive: bool) -> Callable:
    """Code of `blend_block` for 4 channels or 5, and one of the two stopping rules."""

    def generate(context, b: ir.IRBuilder, signature, arguments):
        arrays = [context.make_array(signature.args[n])(context, b, arguments[n]).data for n in (0, 1, 6)]
        entries, members, states = arrays
        first, last, x0, y0, at = (arguments[n] for n in (2, 3, 4, 5, 7))
        lanes = _Lanes(b)
        alpha_max, stop = (lanes.spread(arguments[n]) for n in (8, 9))
        x = b.fadd(lanes.constant([lane % SIDE for lane in range(LANES)]), lanes.spread(x0))
        y = [
            b.fadd(lanes.constant([ROWS * j + lane // SIDE for lane in range(LANES)]), lanes.spread(y0))
            for j in range(VECTORS)
        ]
        state = [[cgutils.alloca_once(b, _VECTOR) for _ in range(VECTORS)] for _ in range(channels)]

        def place(channel: int, j: int) -> ir.Value:
            return b.gep(states, [b.add(at, ir.Constant(_LONG, channel * SIDE * SIDE + j * LANES))])

        for channel in range(channels):
            for j in range(VECTORS):
                b.store(lanes.load(place(channel, j)), state[channel][j])
        position = cgutils.alloca_once_value(b, first)
        head, body, look, end = (b.append_basic_block(name) for name in ("head", "body", "look", "end"))
        b.branch(head)
        b.position_at_end(head)
        b.cbranch(b.icmp_signed("<", b.load(position), last), body, end)
        b.position_at_end(body)
        now = b.load(position)
        member = b.zext(b.load(b.gep(members, [now])), _LONG)
        entry = b.gep(entries, [b.mul(member, ir.Constant(_LONG, ENTRY))])
        _blend_one(lanes, entry, x, y, [alpha_max, stop], state, channels, inclusive)
        following = b.add(now, ir.Constant(_LONG, 1))
        b.store(following, position)
        due = b.icmp_signed("==", b.and_(following, ir.Constant(_LONG, CHECK - 1)), ir.Constant(_LONG, 0))
        b.cbranch(due, look, head)

        def anything_live() -> ir.Value:
            most = b.load(state[0][0])
            for j in range(1, VECTORS):
                light = b.load(state[0][j])
                most = b.select(b.fcmp_ordered(">", light, most), light, most)
            live = b.fcmp_ordered(">", most, stop if inclusive else lanes.constant(0.0))
            return b.icmp_unsigned("!=", b.bitcast(live, ir.IntType(LANES)), ir.Constant(ir.IntType(LANES), 0))

        b.position_at_end(look)
        b.cbranch(anything_live(), head, end)
        b.position_at_end(end)
        for channel in range(channels):
            for j in range(VECTORS):
                lanes.store(b.load(state[channel][j]), place(channel, j))
        return b.zext(anything_live(), _LONG)

    return generate


def _typed(function: Callable) -> Any:
    """`numba.extending.intrinsic`, whose stub takes the typing context for an argument of the call."""
    return intrinsic(function)


def _signature(entries, members, states):
    scalars = (types.int64, types.int64, types.float32, types.float32)
    return types.int64(entries, members, *scalars, states, types.int64, *(types.float32,) * 2)


@_typed
def blend_colour(typing, entries, members, first, last, x0, y0, states, at, alpha_max, stop):
    """Blend entries[members[first:last]] into the block states[at:], whose first pixel lies (x0, y0) px from the tile's
    centre; returns whether anything can still change. The Gaussian that finishes a pixel is added."""
    return _signature(entries, members, states), _block_loop(4, True)


@_typed
def blend_depth(typing, entries, members, first, last, x0, y0, states, at, alpha_max, stop):
    """As `blend_colour`, with the depth sum."""
    return _signature(entries, members, states), _block_loop(5, True)


@_typed
def blend_exclusive(typing, entries, members, first, last, x0, y0, states, at, alpha_max, stop):
    """As `blend_depth`; the Gaussian that would finish a pixel is left out, and the pixel's light becomes negative."""
    return _signature(entries, members, states), _block_loop(5, False)


@_typed
def prefetch(typing, array, index):
    """Ask for the cache line of array[index], which may lie anywhere."""

    def generate(context, b: ir.IRBuilder, signature, arguments):
        data = context.make_array(signature.args[0])(context, b, arguments[0]).data
        pointer = b.bitcast(b.gep(data, [arguments[1]]), _BYTE.as_pointer())
        kind = ir.FunctionType(ir.VoidType(), [_BYTE.as_pointer(), _INT, _INT, _INT])
        function = cgutils.get_or_insert_function(b.module, kind, "llvm.prefetch.p0")
        b.call(function, [pointer, ir.Constant(_INT, 0), ir.Constant(_INT, 3), ir.Constant(_INT, 1)])
        return context.get_dummy_value()

    return types.void(array, types.int64), generate
