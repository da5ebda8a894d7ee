"""Float64 EWA projection of Gaussians (Eq. 17-18): records to blend, boxes to bin, and counts of culled ones by reason.

A footprint is stored as a factor of the 2-D covariance (Zwicker et al. 2001), never as the covariance itself, which
loses thin splats to rounding and inversion. With A = [J W R S | sqrt(dilation) I] (2 x 5, rows a1, a2) the triangle
    l1 = |a1|,  k = a1.a2 / l1^2,  l2 = |a2 - k a1| = sqrt(det(A A^T)) / l1
gives the squared Mahalanobis distance (dx / l1)^2 + ((dy - k dx) / l2)^2, which cannot be negative. The determinant is
the sum of squared 2 x 2 minors of A (Cauchy-Binet), so nothing cancels however long the needle.

The arithmetic is IEEE without contraction: the bits of a record do not depend on a Gaussian's vector lane.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera
from .access import BLOCK, get, get_field, larger, put, smaller
from .definition import Definition
from .footprint import (
    DEPTH_EXTENT,
    FINITE,
    FIRST_X,
    FIRST_Y,
    HALF_WIDTH,
    LAST_X,
    LAST_Y,
    LIMIT,
    LOG_ALPHA_MIN,
    OUTPUTS,
    X,
    Z,
    footprints,
)
from .kernel_cache import kernel
from .parallel import run_ranges
from .prepare import (
    DEPTH,
    EXTENT,
    FIELDS,
    LOG2_CUT,
    LOG2_OPACITY,
    LOG_OPACITY,
    OPACITY,
    RECORD,
    RED,
    Prepared,
    Workspace,
)
from .shade import shades
from .spans import TILE, add_to_counts, packed_box, small_box, unpacked_box

DRAWN, NEAR, FAR, FAINT, NOT_FINITE, OUTSIDE, CROSSING = range(7)
LOG2E = 1.0 / math.log(2.0)
REASONS = {"near": NEAR, "far": FAR, "faint": FAINT, "not_finite": NOT_FINITE, "outside": OUTSIDE}


@dataclass(frozen=True, eq=False)
class Projection:
    """The projection of N Gaussians into one camera; rows of culled ones are undefined."""

    space: Workspace  # records, extents, boxes (see `spans.py`) and depths
    drawn: NDArray[np.int32]  # (M,) indices of those drawn, ascending
    counts: NDArray[np.int64]  # (tiles,) Gaussians in each tile
    culled: dict[str, int]  # reason -> number of culled Gaussians
    crossing: int  # drawn Gaussians whose three-sigma extent reaches behind the near plane


def project(
    scene: Prepared, camera: Camera, definition: Definition, degree: int, threads: int, space: Workspace
) -> Projection:
    """Project all Gaussians into `camera` using the buffers `space`; positions are first made relative to the camera
    centre, in float64."""
    count = scene.count
    view = np.concatenate([camera.rotation.T.ravel(), camera.center])
    margin_x = definition.fov_margin * 0.5 * camera.width
    margin_y = definition.fov_margin * 0.5 * camera.height
    lens = np.array(
        [  # in the order of the fields of `footprint.py`
            camera.fx, camera.fy, camera.cx, camera.cy,
            -(camera.cx + margin_x) / camera.fx, (camera.width - camera.cx + margin_x) / camera.fx,
            -(camera.cy + margin_y) / camera.fy, (camera.height - camera.cy + margin_y) / camera.fy,
            definition.dilation, math.log(definition.alpha_min), definition.cut_radius * definition.cut_radius,
            camera.width, camera.height,
        ]
    )  # fmt: skip
    cuts = np.array([definition.near, definition.far, definition.alpha_min])
    columns = -(-camera.width // TILE)
    tiles = columns * -(-camera.height // TILE)
    parts = 4 * threads if threads > 1 else 1
    bounds = np.unique(np.linspace(0, len(scene.geometry), parts + 1).astype(np.int64))
    counts = {int(start): np.zeros(tiles, np.int64) for start in bounds[:-1]}
    reasons = {int(start): np.zeros(CROSSING + 1, np.int64) for start in bounds[:-1]}
    out = (space.records, space.records.view(np.float32), space.extents, space.boxes, space.depths, space.drawn)
    run_ranges(
        lambda first, last: project_range(
            first, last, count, scene.geometry, scene.harmonics, degree, view, lens, cuts, columns, *out, counts[first],
            reasons[first],
        ),
        bounds,
        threads,
    )  # fmt: skip
    total = sum(reasons.values(), np.zeros(CROSSING + 1, np.int64))
    kept = [space.drawn[start * BLOCK : start * BLOCK + found[DRAWN]] for start, found in reasons.items()]
    return Projection(
        space,
        np.concatenate(kept) if kept else np.empty(0, np.int32),
        sum(counts.values(), np.zeros(tiles, np.int64)),
        {reason: int(total[code]) for reason, code in REASONS.items()},
        int(total[CROSSING]),
    )


@kernel()
def project_range(
    first, last, count, geometry, harmonics, degree, view, lens, cuts, columns, records, narrow, extents, boxes, depths,
    drawn, counts, reasons,
):  # fmt: skip
    """Project blocks first..last-1 into the rows of their Gaussians; indices of drawn ones fill `drawn` from the first
    row on.

    reasons (7,): counts of drawn and culled Gaussians by code, and of drawn ones that cross the near plane.
    """
    near, far, alpha_min = get(cuts, 0), get(cuts, 1), get(cuts, 2)
    lowest_cut, limit = get(lens, LOG_ALPHA_MIN), get(lens, LIMIT)
    flat, weights, colours = np.empty(OUTPUTS * BLOCK), np.empty(16 * BLOCK), np.empty(3 * BLOCK, np.float32)
    block_harmonics = harmonics.size // geometry.shape[0]
    listed = first * BLOCK
    for block in range(first, last):
        fields = block * FIELDS * BLOCK
        footprints(geometry, fields, view, lens, flat)
        before = listed
        for j in range(smaller(BLOCK, count - block * BLOCK)):
            i = block * BLOCK + j
            z = get_field(flat, j, Z)
            put(depths, i, z)
            first_x, last_x = get_field(flat, j, FIRST_X), get_field(flat, j, LAST_X)
            first_y, last_y = get_field(flat, j, FIRST_Y), get_field(flat, j, LAST_Y)
            status = DRAWN
            if not z > near:  # written so that NaN is culled too
                status = NEAR
            elif z > far:
                status = FAR
            elif not get_field(geometry, fields + j, OPACITY) >= alpha_min:
                status = FAINT
            elif not get_field(flat, j, FINITE) < 1e150:  # the sum is not finite if any part is not
                status = NOT_FINITE
            elif not (first_x <= last_x and first_y <= last_y):
                status = OUTSIDE
            put(reasons, status, get(reasons, status) + 1)
            if status != DRAWN:
                continue
            put(drawn, listed, i)
            listed += 1
            box = packed_box(first_x, last_x, first_y, last_y)
            put(boxes, i, box)
            record = i * RECORD
            for field in range(5):
                put(records, record + field, get_field(flat, j, X + field))
            for field in range(EXTENT):
                put(extents, i * EXTENT + field, get_field(flat, j, HALF_WIDTH + field))
            log_opacity = get_field(geometry, fields + j, LOG_OPACITY)
            put(narrow, 2 * record + LOG2_OPACITY, log_opacity * LOG2E)
            put(narrow, 2 * record + LOG2_CUT, larger(lowest_cut, log_opacity - 0.5 * limit) * LOG2E)
            put(narrow, 2 * record + DEPTH, z)
            crosses = (z - near) * (z - near) < 9.0 * get_field(flat, j, DEPTH_EXTENT)
            put(reasons, CROSSING, get(reasons, CROSSING) + crosses)
            left, right, top, bottom = unpacked_box(box)
            if small_box(left, right, top, bottom):  # inlined: a call with arrays costs more than the loops
                for tile_row in range(top, bottom + 1):
                    for column in range(left, right + 1):
                        tile = tile_row * columns + column
                        put(counts, tile, get(counts, tile) + 1)
            else:
                add_to_counts(boxes, records, extents, i, columns, counts)
        if listed == before:
            continue
        shades(geometry, fields, harmonics, block * block_harmonics, degree, view, weights, colours)
        for position in range(before, listed):
            member = np.int64(get(drawn, position))
            for channel in range(3):
                put(narrow, 2 * RECORD * member + RED + channel, get_field(colours, member - block * BLOCK, channel))
