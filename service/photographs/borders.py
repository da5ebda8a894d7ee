"""Detection of uniform bars at the borders of a photograph (letterbox, pillarbox, frames), which are masked.

Bars lie at two opposite sides or at all four, have one colour, equal thickness at opposite sides, and straight edges
over the whole side. A backdrop lacks one of these: it ends at an object's silhouette, surrounds the object, or fades.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..cameras.view_checks import Notice
from .images import Photo

TOLERANCE = 12  # of 255; JPEG of quality 75 changes the levels of a bar by less, except in blocks at its edge
CLEARLY = 2 * TOLERANCE  # a pixel that differs by more from a bar's colour does not belong to it
UNIFORM = 0.98  # least share of a uniform line's pixels within the tolerance
SAMPLED = 512  # least number of pixels of a line that are sampled for this, where it has so many
BLOCK = 8  # lines of a JPEG block, within which the edge of a bar rings
# At an edge the share of clearly differing pixels rises from at most FEW, with most within the tolerance, within EDGE
# lines: to above MOST at both bars, or to above SOME at one and MOST on average for bars within ALIKE px of each other.
FEW, SOME, MOST = 0.1, 0.25, 0.5
EDGE = 3
# Least share of clearly differing pixels at each of the other two sides, between the bars: an object in front of a
# backdrop does not extend there. The maximum over as many lines as are too thin for a bar: film frames have black ones.
REACHES = 0.1
CORNER = 0.02  # of the sides of the framed picture: an object with round corners in front of a backdrop has none there
SEAM = 1  # line past the edge that is masked too: resizing blends it with the bar
THINNEST, THINNEST_SHARE = 3, 0.01  # least thickness: px, and share of the side
THICKEST_SHARE = 0.4  # largest thickness, as a share of the side
ALIKE, ALIKE_SHARE = 3, 0.25  # largest difference of a pair's thicknesses: px, and share of the thicker bar
FRAME_SHARE = 0.02  # the same share in a frame: an object in front of a backdrop is placed like a picture in its frame
_STRIP = 32  # lines processed at a time

Pixels = NDArray[np.uint8]  # (H, W, 3)
Lines = NDArray[np.uint8]  # (N, L, 3), rows or columns, from a border inwards
Colour = NDArray[np.float64]  # (3,)
Sides = tuple[str, str]

ROWS, COLUMNS = ("top", "bottom"), ("left", "right")


@dataclass(frozen=True)
class Bars:
    """A pair of bars: the px masked at each side, and their mean colour."""

    sides: Sides
    widths: tuple[int, int]
    colour: tuple[int, ...]  # RGB levels, mean of the two


def without_bars(photo: Photo) -> tuple[Photo, list[Bars]]:
    """The photograph with the bars at its borders masked, and the bars; unchanged without bars or with a mask."""
    if photo.own_mask or photo.mask is not None:
        return photo, []
    found = _frame(photo.rgb)
    window = _inside(photo.rgb, found)
    for sides in (ROWS, COLUMNS, ROWS):  # rows again, for a letterbox inside a pillarbox
        if all(bars.sides != sides for bars in found):
            pixels = photo.rgb[window]
            pair = _pair(_lines(pixels, sides), _colours(pixels, sides), slice(None), ALIKE_SHARE)
            if pair is not None and _reaches(_lines(pixels, sides), *pair):
                found.append(Bars(sides, *pair))
            window = _inside(photo.rgb, found)
    if not found:
        return photo, []
    mask = np.zeros((photo.height, photo.width), np.bool_)
    mask[window] = True
    return replace(photo, mask=mask), found


def bars_notice(found: list[Bars], photo: Photo, index: int) -> Notice:
    """The notice about the bars `found` in photograph `index`, which `without_bars` has masked."""
    each = ", ".join(
        f"{bars.widths[0]} px at the {bars.sides[0]} and {bars.widths[1]} px at the {bars.sides[1]} of the colour "
        f"{bars.colour}"
        for bars in found
    )
    share = 0.0 if photo.mask is None else 1 - photo.mask.mean()
    message = (
        f"the photograph of {photo.width} x {photo.height} px has bars at its borders, {each}: {share:.0%} of it is "
        "left out like masked pixels, and the scene has there what other photographs show; crop the photographs and "
        "take what goes at the left from cx and at the top from cy, or send an alpha channel to keep the bars"
    )
    return {"code": "border_left_out", "field": "images", "index": index, "message": message}


def _frame(rgb: Pixels) -> list[Bars]:
    """Both pairs of bars of a frame in one colour; empty unless it is complete. Edges of a pair are searched within the
    other pair."""
    colours = {sides: _colours(rgb, sides) for sides in (ROWS, COLUMNS)}
    given = [colour for pair in colours.values() for colour in pair or ()]
    if len(given) < 4 or np.ptp(given, axis=0).max() > TOLERANCE:
        return []
    inner = {}
    for sides, pair in colours.items():
        lines = _lines(rgb, sides)
        first, last = (_run(end, colour) for end, colour in zip((lines, lines[::-1]), pair or (), strict=True))
        if first is None or last is None:
            return []
        inner[sides] = slice(first, len(lines) - last)
    found = []
    for sides, other in ((ROWS, COLUMNS), (COLUMNS, ROWS)):
        pair_found = _pair(_lines(rgb, sides), colours[sides], inner[other], FRAME_SHARE)
        if pair_found is None:
            return []
        found.append(Bars(sides, *pair_found))
    return found if _has_corners(rgb[_inside(rgb, found)], given[0]) else []


def _has_corners(rgb: Pixels, colour: Colour) -> bool:
    """Whether any corner of the picture in a frame differs from the frame's `colour`."""
    height, width = (max(1, round(CORNER * side)) for side in rgb.shape[:2])
    differ = _differing(np.concatenate([rgb[:height], rgb[-height:]]), colour)
    return any(part.mean() > MOST for half in np.split(differ, 2) for part in (half[:, :width], half[:, -width:]))


def _pair(
    lines: Lines, colours: list[Colour] | None, along: slice, share: float
) -> tuple[tuple[int, int], tuple[int, ...]] | None:
    """Thicknesses and colour of a pair of bars at both ends of `lines`; None where there is no pair.

    `colours` are those of the outermost lines, `along` the part of each line that is searched for an edge, `share` the
    largest difference of the thicknesses relative to the thicker bar.
    """
    if colours is None or np.ptp(colours, axis=0).max() > TOLERANCE:
        return None
    widths, shares, thinnest = [], [], max(THINNEST, THINNEST_SHARE * len(lines))
    for end, colour in zip((lines, lines[::-1]), colours, strict=True):
        run = _run(end, colour)
        edge = None if run is None else _edge(end[:, along], colour, run)
        if edge is None or not thinnest <= edge[0] <= THICKEST_SHARE * len(lines):
            return None
        widths.append(edge[0])
        shares.append(edge[1])
    first, last = widths
    apart = max(ALIKE, share * max(widths)) if min(shares) > MOST else ALIKE
    if np.mean(shares) <= MOST or abs(first - last) > apart:
        return None
    red, green, blue = (int(level) for level in np.rint(np.mean(colours, axis=0)))
    return (first + SEAM, last + SEAM), (red, green, blue)


def _reaches(lines: Lines, widths: tuple[int, int], colour: tuple[int, ...]) -> bool:
    """Whether the picture between two bars extends to both other sides."""
    between = lines[widths[0] : len(lines) - widths[1]]
    thin = max(THINNEST, round(THINNEST_SHARE * between.shape[1]))
    ends = (between[:, :thin], between[:, -thin:])
    return all(_differing(end, np.array(colour)).mean(axis=0).max() >= REACHES for end in ends)


def _lines(rgb: Pixels, sides: Sides) -> Lines:
    return rgb if sides == ROWS else rgb.transpose(1, 0, 2)


def _inside(rgb: Pixels, found: list[Bars]) -> tuple[slice, slice]:
    """Slices of the rows and columns without these bars."""
    widths = {bars.sides: bars.widths for bars in found}
    (top, bottom), (left, right) = (widths.get(sides, (0, 0)) for sides in (ROWS, COLUMNS))
    return slice(top, rgb.shape[0] - bottom), slice(left, rgb.shape[1] - right)


def _colours(rgb: Pixels, sides: Sides) -> list[Colour] | None:
    """Median colours of the outermost lines of both sides; None unless both are uniform."""
    colours = []
    for line in _lines(rgb, sides)[[0, -1]]:
        colour = np.median(line, axis=0)
        if _near(line[None], colour)[0] < UNIFORM:
            return None
        colours.append(colour)
    return colours


def _run(lines: Lines, colour: Colour) -> int | None:
    """Number of uniform lines from the first on; None where these are too many for a bar."""
    thickest, step = int(THICKEST_SHARE * len(lines)), max(1, lines.shape[1] // SAMPLED)
    for start in range(0, thickest + 1, _STRIP):
        uniform = _near(lines[start : start + _STRIP, ::step], colour) >= UNIFORM
        if not uniform.all():
            run = start + int(uniform.argmin())
            return run if run <= thickest else None
    return None


def _edge(lines: Lines, colour: Colour, run: int) -> tuple[int, float] | None:
    """Index of the first line past a straight edge that follows `run` uniform lines, up to a JPEG block later, and the
    share of clearly differing pixels there; None without such an edge."""
    start = max(run - EDGE, 0)
    lines = lines[start : run + BLOCK + 2 * EDGE]
    differ = _differing(lines, colour).mean(axis=1)
    beyond = differ[run - start : run - start + BLOCK + EDGE] > SOME
    if not beyond.any():
        return None
    edge = run - start + int(beyond.argmax())
    last = max(edge - EDGE, 0)
    if differ[last] > FEW or _near(lines[last : last + 1], colour)[0] < MOST:
        return None
    return start + edge, float(differ[edge : edge + EDGE].max())


def _near(lines: Lines, colour: Colour) -> NDArray[np.float64]:
    """(N,) share of each line's pixels with all levels within TOLERANCE of `colour`."""
    low, high = (np.clip(np.rint(colour + off), 0, 255).astype(np.uint8) for off in (-TOLERANCE, TOLERANCE))
    pixels = np.ascontiguousarray(lines)
    return ((pixels >= low) & (pixels <= high)).all(axis=2).mean(axis=1)


def _differing(lines: Lines, colour: Colour) -> NDArray[np.bool_]:
    """(N, L) mask of pixels with a level more than CLEARLY from that of `colour`."""
    away: NDArray[np.float64] = np.abs(lines - colour).max(axis=2)
    return away > CLEARLY
