"""The innermost loop of blending in explicit 16-lane vectors: a list of Gaussians over one block of 8 x 8 pixels.

It is emitted as LLVM IR, since auto-vectorised loops do not keep a block's transmittance and colours in registers: four
vectors per channel hold its 64 pixels, two rows of 8 each. LLVM splits vectors that are longer than the processor's.
`reference.py` computes the same in float64, and tests compare them.
"""

from __future__ import annotations

from collections.abc import Callable

from llvmlite import ir
from numba import types
from numba.core import cgutils

from .access import data_of, typed
from .lanes import LANES, LONG, MASK, VECTOR, Lanes

SIDE = 8  # px of a block
VECTORS = SIDE * SIDE // LANES
ROWS = LANES // SIDE  # of a block in one vector
PIXELS = SIDE * SIDE
# Channels of a block's state, PIXELS floats each: the first 4 for colours alone, the first 5 with depth.
LIGHT, COLOUR, DEPTH_SUM, REMOVED, MEDIAN = 0, 1, 4, 5, 6
COLOURS_ONLY, WITH_DEPTH, ALL_CHANNELS = 4, 5, 7
CHECK = 8  # Gaussians between tests whether all pixels of the block are finished; a power of two

# Fields of a list entry, relative to the tile's centre; an entry is one cache line.
# A depth with its sign bit set marks a Gaussian of the subset whose weights are summed as REMOVED.
U1, STEP1, U2, SHEAR2, STEP2, LOG2_OPACITY, RED, GREEN, BLUE, DEPTH, CUT = range(11)
ENTRY = 16  # floats


def spread_field(lanes: Lanes, entry: ir.Value, index: int) -> ir.Value:
    """A field of an entry, broadcast to all lanes."""
    return lanes.spread(lanes.b.load(lanes.b.gep(entry, [ir.Constant(LONG, index)])))


def layer(
    lanes: Lanes, entry: ir.Value, x: ir.Value, y: list[ir.Value]
) -> tuple[list[ir.Value], list[ir.Value]]:  # fmt: skip
    """Masks of the pixels where an entry passes its cut, and its alphas, not yet limited and undefined elsewhere."""
    each = range(VECTORS)
    across = lanes.fma(x, spread_field(lanes, entry, STEP1), spread_field(lanes, entry, U1))
    level = lanes.fma(lanes.minus(across), across, spread_field(lanes, entry, LOG2_OPACITY))
    start = lanes.fma(lanes.minus(x), spread_field(lanes, entry, SHEAR2), spread_field(lanes, entry, U2))
    step = spread_field(lanes, entry, STEP2)
    down = [lanes.fma(y[j], step, start) for j in each]
    power = [lanes.fma(lanes.minus(down[j]), down[j], level) for j in each]
    cut = spread_field(lanes, entry, CUT)
    return [lanes.b.fcmp_ordered(">=", power[j], cut) for j in each], [lanes.power_of_two(power[j]) for j in each]


def pixel_places(lanes: Lanes, x0: ir.Value, y0: ir.Value) -> tuple[ir.Value, list[ir.Value]]:
    """x of the lanes, and y of the lanes of each vector, for a block whose first pixel centre is (x0, y0)."""
    b = lanes.b
    x = b.fadd(lanes.constant([lane % SIDE for lane in range(LANES)]), lanes.spread(x0))
    rows = ([float(ROWS * j + lane // SIDE) for lane in range(LANES)] for j in range(VECTORS))
    return x, [b.fadd(lanes.constant(row), lanes.spread(y0)) for row in rows]


def _blend_one(lanes: Lanes, entry: ir.Value, x: ir.Value, y: list[ir.Value], cuts: list[ir.Value],
               state: list[list[ir.Value]], exclusive: bool) -> tuple[list[ir.Value], list[ir.Value]]:  # fmt: skip
    """Blend one entry into the block state in the stack slots `state[channel][vector]`; returns its weights and the
    masks of the pixels that it was blended into.

    Steps are interleaved over the vectors, so that their dependency chains overlap.
    """
    b, each = lanes.b, range(VECTORS)
    alpha_max, stop = cuts

    def field(index: int) -> ir.Value:
        return spread_field(lanes, entry, index)

    def add(channel: int, factors: list[ir.Value], value: ir.Value) -> None:
        for j in each:
            b.store(lanes.fma(factors[j], value, b.load(state[channel][j])), state[channel][j])

    seen, alpha = layer(lanes, entry, x, y)
    alpha = [b.select(b.fcmp_ordered("<", a, alpha_max), a, alpha_max) for a in alpha]
    light = [b.load(state[LIGHT][j]) for j in each]
    none = lanes.constant(0.0)
    if not exclusive:
        counts = [b.and_(seen[j], b.fcmp_ordered(">", light[j], stop)) for j in each]
        weight = [b.select(counts[j], b.fmul(alpha[j], light[j]), none) for j in each]
        left = [b.fsub(light[j], weight[j]) for j in each]
    else:  # a pixel that the Gaussian would finish ends without it: its transmittance is negated
        live = [b.fcmp_ordered(">", light[j], none) for j in each]
        weight = [b.select(seen[j], b.fmul(alpha[j], light[j]), none) for j in each]
        left = [b.fsub(light[j], weight[j]) for j in each]
        goes_on = [b.fcmp_ordered(">=", left[j], stop) for j in each]
        counts = [b.and_(b.and_(seen[j], live[j]), goes_on[j]) for j in each]
        weight = [b.select(goes_on[j], weight[j], none) for j in each]
        finished = [b.select(live[j], lanes.minus(light[j]), light[j]) for j in each]
        left = [b.select(goes_on[j], left[j], finished[j]) for j in each]
    for j in each:
        b.store(left[j], state[LIGHT][j])
    for channel, shade in enumerate((RED, GREEN, BLUE), COLOUR):
        add(channel, weight, field(shade))
    if len(state) == WITH_DEPTH:
        add(DEPTH_SUM, weight, field(DEPTH))
    elif len(state) == ALL_CHANNELS:
        signed, half = field(DEPTH), lanes.constant(0.5)
        chosen = lanes.negative(signed)
        depth = b.select(chosen, lanes.minus(signed), signed)
        add(DEPTH_SUM, weight, depth)
        add(REMOVED, weight, b.select(chosen, lanes.constant(1.0), none))
        for j in each:
            passes = b.and_(b.fcmp_ordered(">", light[j], half), b.fcmp_ordered("<=", left[j], half))
            before = b.load(state[MEDIAN][j])
            b.store(b.select(b.and_(passes, counts[j]), depth, before), state[MEDIAN][j])
    return weight, counts


def _block_loop(channels: int, exclusive: bool) -> Callable:
    """Code generator of `blend_block` for 4, 5 or 7 channels and one of the two stopping rules."""

    def generate(context, b: ir.IRBuilder, signature, arguments):
        entries, chosen, states, tops = (data_of(context, b, signature.args[n], arguments[n]) for n in (0, 1, 5, 9))
        kept, x0, y0, at = (arguments[n] for n in (2, 3, 4, 6))
        lanes, each = Lanes(b), range(VECTORS)
        alpha_max, stop = (lanes.spread(arguments[n]) for n in (7, 8))
        x, y = pixel_places(lanes, x0, y0)
        state = [[cgutils.alloca_once(b, VECTOR) for _ in each] for _ in range(channels)]
        zero = ir.Constant(LONG, 0)

        def place(channel: int, j: int) -> ir.Value:
            return b.gep(states, [b.add(at, ir.Constant(LONG, channel * PIXELS + j * LANES))])

        for channel in range(channels):
            for j in each:
                b.store(lanes.load(place(channel, j)), state[channel][j])
        position, pairs = cgutils.alloca_once_value(b, zero), cgutils.alloca_once_value(b, zero)
        head, body, look, end = (b.append_basic_block(name) for name in ("head", "body", "look", "end"))
        b.branch(head)
        b.position_at_end(head)
        b.cbranch(b.icmp_signed("<", b.load(position), kept), body, end)
        b.position_at_end(body)
        now = b.load(position)
        member = b.zext(b.load(b.gep(chosen, [now])), LONG)
        entry = b.gep(entries, [b.mul(member, ir.Constant(LONG, ENTRY))])
        weight, counts = _blend_one(lanes, entry, x, y, [alpha_max, stop], state, exclusive)
        if channels == ALL_CHANNELS:
            top = b.gep(tops, [member])
            before, most = b.load(top), lanes.largest(weight)
            b.store(b.select(b.fcmp_ordered(">", most, before), most, before), top)
            b.store(b.add(b.load(pairs), lanes.count_set(counts)), pairs)
        following = b.add(now, ir.Constant(LONG, 1))
        b.store(following, position)
        due = b.icmp_signed("==", b.and_(following, ir.Constant(LONG, CHECK - 1)), zero)
        b.cbranch(due, look, head)

        def anything_live() -> ir.Value:
            most = b.load(state[LIGHT][0])
            for j in range(1, VECTORS):
                light = b.load(state[LIGHT][j])
                most = b.select(b.fcmp_ordered(">", light, most), light, most)
            live = b.fcmp_ordered(">", most, lanes.constant(0.0) if exclusive else stop)
            return b.icmp_unsigned("!=", b.bitcast(live, MASK), ir.Constant(MASK, 0))

        b.position_at_end(look)
        b.cbranch(anything_live(), head, end)
        b.position_at_end(end)
        for channel in range(channels):
            for j in each:
                lanes.store(b.load(state[channel][j]), place(channel, j))
        return b.add(b.zext(anything_live(), LONG), b.shl(b.load(pairs), ir.Constant(LONG, 1)))

    return generate


@typed
def blend_block(
    typing, entries, chosen, kept, x0, y0, states, at, alpha_max, stop, tops, depth, median, exclusive
):  # fmt: skip
    """Blend entries[chosen[:kept]] into the block states[at:], whose first pixel centre lies at (x0, y0) px from the
    tile's; returns 1 if any pixel is unfinished, plus twice the blended pairs of a Gaussian and a pixel where counted.

    The types of the last three arguments select a specialised loop: `depth` and `median` are None or planes;
    `exclusive` is None (the Gaussian that finishes a pixel is blended) or anything else (it is not, and the pixel's
    transmittance is negated). With `median` all channels are computed, pairs are counted, and tops[chosen] is raised to
    each entry's largest weight.
    """
    channels = ALL_CHANNELS if median != types.none else WITH_DEPTH if depth != types.none else COLOURS_ONLY
    numbers = (types.float32,) * 2
    signature = types.int64(
        entries, chosen, types.int64, *numbers, states, types.int64, *numbers, tops, depth, median, exclusive
    )
    return signature, _block_loop(channels, exclusive != types.none)
