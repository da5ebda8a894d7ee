"""The innermost loop of `leverage.py` as 16-lane vectors: one list of Gaussians over one block of 8 x 8 pixels."""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.core import cgutils

from .access import data_of, typed
from .lanes import LANES, LONG, VECTOR, Lanes
from .vectors import BLUE, ENTRY, GREEN, PIXELS, RED, VECTORS, layer, pixel_places, spread_field

# Channels of a block's state, PIXELS floats each; REST, the colour behind, and RESIDUAL, weighted, have three each.
LIGHT, REST, RESIDUAL, WEIGHT, CHANNELS = 0, 1, 4, 7, 8
# An entry's sums over pixels: w r J times its opacity, w J^2 times its square, w s, and w r s per channel, with its
# blending weight s.
SLOPE, MOVED, SHOWN, EXCESS, SUMS = 0, 1, 2, 3, 6


def _add_one(lanes: Lanes, entry: ir.Value, x: ir.Value, y: list[ir.Value], cuts: list[ir.Value],
             state: list[list[ir.Value]]) -> list[ir.Value]:  # fmt: skip
    """Subtract one entry's layer from what lies behind; returns its sums over the block's pixels."""
    b, each = lanes.b, range(VECTORS)
    alpha_max, stop = cuts
    none, one = lanes.constant(0.0), lanes.constant(1.0)
    seen, free = layer(lanes, entry, x, y)
    light = [b.load(state[LIGHT][j]) for j in each]
    counts = [b.and_(seen[j], b.fcmp_ordered(">", light[j], stop)) for j in each]
    limited = [b.fcmp_ordered("<", free[j], alpha_max) for j in each]
    alpha = [b.select(limited[j], free[j], alpha_max) for j in each]
    weight = [b.select(counts[j], b.fmul(alpha[j], light[j]), none) for j in each]
    for j in each:
        b.store(b.fsub(light[j], weight[j]), state[LIGHT][j])
    # Where alpha_max limits alpha, its derivative by the opacity is 0.
    moves = [b.and_(counts[j], limited[j]) for j in each]
    own = [b.select(moves[j], weight[j], none) for j in each]
    through = [b.select(moves[j], b.fdiv(alpha[j], b.fsub(one, alpha[j])), none) for j in each]
    slopes, squares, excess = [none for _ in each], [none for _ in each], []
    for channel, shade in enumerate((RED, GREEN, BLUE)):
        colour = spread_field(lanes, entry, shade)
        for j in each:
            rest = lanes.fma(lanes.minus(weight[j]), colour, b.load(state[REST + channel][j]))
            b.store(rest, state[REST + channel][j])
            by = lanes.fma(lanes.minus(through[j]), rest, b.fmul(own[j], colour))
            slopes[j] = lanes.fma(b.load(state[RESIDUAL + channel][j]), by, slopes[j])
            squares[j] = lanes.fma(by, by, squares[j])
        excess.append([b.fmul(weight[j], b.load(state[RESIDUAL + channel][j])) for j in each])
    counted = [b.load(state[WEIGHT][j]) for j in each]
    squares = [b.fmul(squares[j], counted[j]) for j in each]
    shown = [b.fmul(weight[j], counted[j]) for j in each]
    return [lanes.total(values) for values in (slopes, squares, shown, *excess)]


@typed
def leverage_block(typing, entries, chosen, kept, x0, y0, states, at, alpha_max, stop, sums):
    """Traverse entries[chosen[:kept]] over the block states[at:], whose first pixel centre lies (x0, y0) px from the
    tile's centre; adds to sums[SUMS * chosen[:kept]]."""
    numbers = (types.float32,) * 2
    signature = types.void(entries, chosen, types.int64, *numbers, states, types.int64, *numbers, sums)

    def generate(context, b: ir.IRBuilder, signature, arguments):
        entries, chosen, states, sums = (data_of(context, b, signature.args[n], arguments[n]) for n in (0, 1, 5, 9))
        kept, x0, y0, at = (arguments[n] for n in (2, 3, 4, 6))
        lanes, each = Lanes(b), range(VECTORS)
        cuts = [lanes.spread(arguments[n]) for n in (7, 8)]
        x, y = pixel_places(lanes, x0, y0)
        state = [[cgutils.alloca_once(b, VECTOR) for _ in each] for _ in range(CHANNELS)]

        def place(channel: int, j: int) -> ir.Value:
            return b.gep(states, [b.add(at, ir.Constant(LONG, channel * PIXELS + j * LANES))])

        for channel in range(CHANNELS):
            for j in each:
                b.store(lanes.load(place(channel, j)), state[channel][j])
        with cgutils.for_range(b, kept) as loop:
            member = b.zext(b.load(b.gep(chosen, [loop.index])), LONG)
            entry = b.gep(entries, [b.mul(member, ir.Constant(LONG, ENTRY))])
            found = _add_one(lanes, entry, x, y, cuts, state)
            for n, value in enumerate(found):
                to = b.gep(sums, [b.add(b.mul(member, ir.Constant(LONG, SUMS)), ir.Constant(LONG, n))])
                b.store(b.fadd(b.load(to), value), to)
        for channel in range(RESIDUAL):  # residual and weight stay as they are
            for j in each:
                lanes.store(b.load(state[channel][j]), place(channel, j))
        return context.get_dummy_value()

    return signature, generate
