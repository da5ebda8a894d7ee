"""The image footprints of one block of Gaussians, in a branch-free loop that LLVM vectorises in float64."""

from __future__ import annotations

import math

from .access import BLOCK, get, get_field, larger, put_field, round_down, round_up, smaller
from .kernel_cache import kernel
from .prepare import FACTOR, LOG_OPACITY, MEAN

# Output fields of `footprints`; X to INVERSE2 begin a record, HALF_WIDTH to OTHER_SHEAR form an extent.
Z, X, Y, INVERSE1, SHEAR, INVERSE2, HALF_WIDTH, HALF_HEIGHT, OTHER_SHEAR = range(9)
FINITE, DEPTH_EXTENT, FIRST_X, LAST_X, FIRST_Y, LAST_Y = range(9, 15)
OUTPUTS = 15

# Fields of the lens: intrinsics, bounds of the tangents within `fov_margin`, and what the definition and the size say.
FX, FY, CX, CY, LOW_X, HIGH_X, LOW_Y, HIGH_Y, DILATION, LOG_ALPHA_MIN, LIMIT, WIDTH, HEIGHT = range(13)

# The exponent is carried as a power of two: 2^-(u1^2 + u2^2) with u scaled by this is exp(-distance^2 / 2).
HALF_LOG2E = math.sqrt(0.5 / math.log(2.0))

# Added to the squared radius of the alpha cut, so that tile lists hold every pixel that float32 lets through: its
# error in the squared distance is below 1e-4 from the default dilation up.
RADIUS_SLACK = 1e-3


@kernel()
def footprints(geometry, start, view, lens, out):
    """Fill `out` field by field for the BLOCK Gaussians whose fields begin at geometry[start]: z; x, y of the centre,
    px; HALF_LOG2E / l1; k; HALF_LOG2E / l2; half width and height of the box, px; the transposed factor's shear; a sum
    that is finite and below 1e150 only if all are; the squared depth extent; first and last column, first and last row
    of the pixels whose centres lie in the box, the first beyond the last if none does.

    view: the rotation camera from world, row-major, and the camera centre; lens: the fields FX to HEIGHT. Gaussians
    behind the camera or not finite give meaningless numbers, without a trap; `project_range` culls them.
    """
    w00, w01, w02 = get(view, 0), get(view, 1), get(view, 2)
    w10, w11, w12 = get(view, 3), get(view, 4), get(view, 5)
    w20, w21, w22 = get(view, 6), get(view, 7), get(view, 8)
    centre_x, centre_y, centre_z = get(view, 9), get(view, 10), get(view, 11)
    fx, fy = get(lens, FX), get(lens, FY)
    cx, cy = get(lens, CX), get(lens, CY)
    low_x, high_x = get(lens, LOW_X), get(lens, HIGH_X)
    low_y, high_y = get(lens, LOW_Y), get(lens, HIGH_Y)
    dilation, log_alpha_min, limit = get(lens, DILATION), get(lens, LOG_ALPHA_MIN), get(lens, LIMIT)
    last_column, last_row = get(lens, WIDTH) - 1.0, get(lens, HEIGHT) - 1.0
    for j in range(BLOCK):
        at = start + j
        # Position relative to the camera centre, still in world axes, then in camera axes.
        px, py = get_field(geometry, at, MEAN) - centre_x, get_field(geometry, at, MEAN + 1) - centre_y
        pz = get_field(geometry, at, MEAN + 2) - centre_z
        x = w00 * px + w01 * py + w02 * pz
        y = w10 * px + w11 * py + w12 * pz
        z = w20 * px + w21 * py + w22 * pz
        inverse_z = 1.0 / z
        tan_x, tan_y = x * inverse_z, y * inverse_z
        mean_x, mean_y = fx * tan_x + cx, fy * tan_y + cy
        # Rows of J W: gradients of the pixel position in the world, at a point at most `fov_margin` out of view.
        tan_x, tan_y = smaller(larger(tan_x, low_x), high_x), smaller(larger(tan_y, low_y), high_y)
        gx, gy = fx * inverse_z, fy * inverse_z
        u0, u1, u2 = gx * (w00 - tan_x * w20), gx * (w01 - tan_x * w21), gx * (w02 - tan_x * w22)
        v0, v1, v2 = gy * (w10 - tan_y * w20), gy * (w11 - tan_y * w21), gy * (w12 - tan_y * w22)
        # Their cross product in closed form: the minors of J are 1 : tan_x : tan_y.
        area = gx * gy
        n0 = area * (w20 + tan_x * w00 + tan_y * w10)
        n1 = area * (w21 + tan_x * w01 + tan_y * w11)
        n2 = area * (w22 + tan_x * w02 + tan_y * w12)
        f00, f01 = get_field(geometry, at, FACTOR), get_field(geometry, at, FACTOR + 1)
        f02, f10 = get_field(geometry, at, FACTOR + 2), get_field(geometry, at, FACTOR + 3)
        f11, f12 = get_field(geometry, at, FACTOR + 4), get_field(geometry, at, FACTOR + 5)
        f20, f21 = get_field(geometry, at, FACTOR + 6), get_field(geometry, at, FACTOR + 7)
        f22 = get_field(geometry, at, FACTOR + 8)
        # J W R S, row by row. Its minors are n . (columns' cross products): the columns are orthogonal, so that the
        # products' lengths are those of their factors and nothing cancels.
        a0, a1, a2 = u0 * f00 + u1 * f10 + u2 * f20, u0 * f01 + u1 * f11 + u2 * f21, u0 * f02 + u1 * f12 + u2 * f22
        b0, b1, b2 = v0 * f00 + v1 * f10 + v2 * f20, v0 * f01 + v1 * f11 + v2 * f21, v0 * f02 + v1 * f12 + v2 * f22
        m0 = n0 * (f11 * f22 - f21 * f12) + n1 * (f21 * f02 - f01 * f22) + n2 * (f01 * f12 - f11 * f02)
        m1 = n0 * (f12 * f20 - f22 * f10) + n1 * (f22 * f00 - f02 * f20) + n2 * (f02 * f10 - f12 * f00)
        m2 = n0 * (f10 * f21 - f20 * f11) + n1 * (f20 * f01 - f00 * f21) + n2 * (f00 * f11 - f10 * f01)
        aa, bb = a0 * a0 + a1 * a1 + a2 * a2, b0 * b0 + b1 * b1 + b2 * b2
        det = m0 * m0 + m1 * m1 + m2 * m2 + dilation * (aa + bb) + dilation * dilation
        l1, column, root = math.sqrt(aa + dilation), math.sqrt(bb + dilation), math.sqrt(det)
        k = (a0 * b0 + a1 * b1 + a2 * b2) / (l1 * l1)
        squared = smaller(2.0 * (get_field(geometry, at, LOG_OPACITY) - log_alpha_min), limit)
        radius = math.sqrt(larger(squared, 0.0) + RADIUS_SLACK)
        put_field(out, j, Z, z)
        put_field(out, j, X, mean_x)
        put_field(out, j, Y, mean_y)
        put_field(out, j, INVERSE1, HALF_LOG2E / l1)
        put_field(out, j, SHEAR, k)
        put_field(out, j, INVERSE2, HALF_LOG2E * l1 / root)
        half_width, half_height = radius * l1, radius * column
        put_field(out, j, HALF_WIDTH, half_width)
        put_field(out, j, HALF_HEIGHT, half_height)
        put_field(out, j, OTHER_SHEAR, root / (column * column))
        put_field(out, j, FINITE, abs(root + l1 * column + k + mean_x + mean_y))
        # Depth extent: |S R^T w| for the camera's z axis w.
        d0, d1 = w20 * f00 + w21 * f10 + w22 * f20, w20 * f01 + w21 * f11 + w22 * f21
        d2 = w20 * f02 + w21 * f12 + w22 * f22
        put_field(out, j, DEPTH_EXTENT, d0 * d0 + d1 * d1 + d2 * d2)
        put_field(out, j, FIRST_X, larger(round_up(mean_x - half_width - 0.5), 0.0))
        put_field(out, j, LAST_X, smaller(round_down(mean_x + half_width - 0.5), last_column))
        put_field(out, j, FIRST_Y, larger(round_up(mean_y - half_height - 0.5), 0.0))
        put_field(out, j, LAST_Y, smaller(round_down(mean_y + half_height - 0.5), last_row))
