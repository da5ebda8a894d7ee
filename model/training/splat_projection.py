"""Numba projection of Gaussians to one image (Eq. 17-18) and its gradient: EWA in float64, never a covariance.

A Gaussian with covariance A A^T becomes the two rows `b1, b2` of J W A (J: the Jacobian of the pinhole projection at
the mean, W: the world-to-camera rotation; Zwicker et al., "EWA Splatting", 2002). Its image covariance, dilated by
d px^2, is kept as the triangle `column_std, row_std, shear` for which, with s = dy / row_std and
t = (dx - shear dy) / column_std, the exponent is -(s^2 + t^2) / 2: there is nothing to invert, nothing can turn
negative, and the extent on every image row is exact.
"""

from __future__ import annotations

import math

import numba as nb
import numpy as np

FASTMATH = {"contract", "reassoc", "arcp", "afn", "nsz"}  # all but nnan and ninf: a NaN must stay a NaN

# A Gaussian further outside the image than this share of its half size is projected with the Jacobian at that limit
# (1.3 tan(fov / 2) where the principal point is central): beyond it the linearisation stretches without bound.
FIELD_OF_VIEW_MARGIN = 0.3

# Scratch layout of `project_gaussian`.
X, Y, Z, FREE_X, FREE_Y, M, B1, B2, ROW_STD, COLUMN_STD, SHEAR, U, V = 0, 1, 2, 3, 4, 5, 11, 14, 17, 18, 19, 20, 21
SCRATCH = 22

LONG_RUN = 64  # depths equal in float32 above which insertion sort, which is quadratic, would be slow


@nb.njit(fastmath=FASTMATH, error_model="numpy", cache=True)
def project_gaussian(mean, factor, camera, width, height, dilation, out):
    """Fill the float64 scratch `out`; `camera` is (16,): world_from_cam rotation row-major, centre, fx, fy, cx, cy.

    `out[Z]` must have been checked by `depth_of` before: it is divided by.
    """
    e0, e1, e2 = mean[0] - camera[9], mean[1] - camera[10], mean[2] - camera[11]
    x = camera[0] * e0 + camera[3] * e1 + camera[6] * e2
    y = camera[1] * e0 + camera[4] * e1 + camera[7] * e2
    z = camera[2] * e0 + camera[5] * e1 + camera[8] * e2
    fx, fy = camera[12], camera[13]
    inverse_z = 1.0 / z
    margin_x, margin_y = FIELD_OF_VIEW_MARGIN * 0.5 * width, FIELD_OF_VIEW_MARGIN * 0.5 * height
    true_x, true_y = x * inverse_z, y * inverse_z
    tan_x = min((width + margin_x - camera[14]) / fx, max((-margin_x - camera[14]) / fx, true_x))
    tan_y = min((height + margin_y - camera[15]) / fy, max((-margin_y - camera[15]) / fy, true_y))
    for j in range(3):
        out[M + j] = fx * inverse_z * (camera[3 * j] - tan_x * camera[3 * j + 2])
        out[M + 3 + j] = fy * inverse_z * (camera[3 * j + 1] - tan_y * camera[3 * j + 2])
    for j in range(3):
        out[B1 + j] = out[M] * factor[0, j] + out[M + 1] * factor[1, j] + out[M + 2] * factor[2, j]
        out[B2 + j] = out[M + 3] * factor[0, j] + out[M + 4] * factor[1, j] + out[M + 5] * factor[2, j]
    variance_y = out[B2] * out[B2] + out[B2 + 1] * out[B2 + 1] + out[B2 + 2] * out[B2 + 2] + dilation
    shear = (out[B1] * out[B2] + out[B1 + 1] * out[B2 + 1] + out[B1 + 2] * out[B2 + 2]) / variance_y
    variance = dilation * (1.0 + shear * shear)
    for j in range(3):
        rest = out[B1 + j] - shear * out[B2 + j]
        variance += rest * rest
    out[X], out[Y], out[Z] = x, y, z
    out[FREE_X] = 1.0 if tan_x == true_x else 0.0  # does the Jacobian follow the mean?
    out[FREE_Y] = 1.0 if tan_y == true_y else 0.0
    out[ROW_STD], out[COLUMN_STD], out[SHEAR] = math.sqrt(variance_y), math.sqrt(variance), shear
    out[U], out[V] = fx * x * inverse_z + camera[14], fy * y * inverse_z + camera[15]


@nb.njit(fastmath=FASTMATH, error_model="numpy", cache=True)
def depth_of(mean, camera):
    """z-depth of a world point."""
    e0, e1, e2 = mean[0] - camera[9], mean[1] - camera[10], mean[2] - camera[11]
    return camera[2] * e0 + camera[5] * e1 + camera[8] * e2


@nb.njit(fastmath=FASTMATH, error_model="numpy", cache=True)
def project_gaussian_backward(factor, camera, out, grad, mean_grad, factor_grad):
    """Backpropagate the image gradient `grad`: add to `mean_grad` (3,) and `factor_grad` (3, 3).

    `out` is the scratch of `project_gaussian`; `grad` holds dL/d (u, v, shear), then row_std dL/d row_std and
    column_std dL/d column_std.
    """
    variance_y = out[ROW_STD] * out[ROW_STD]
    variance = out[COLUMN_STD] * out[COLUMN_STD]
    shear = out[SHEAR]
    # Chain through row_std^2 = Syy, shear = Sxy / Syy, column_std^2 = Sxx - Sxy^2 / Syy.
    g_xx = 0.5 * grad[4] / variance
    g_shear = grad[2] / variance_y
    g_xy = g_shear - 2.0 * shear * g_xx
    g_yy = 0.5 * grad[3] / variance_y - shear * g_shear + shear * shear * g_xx
    g_tan_x, g_tan_y, g_m_x, g_m_y = 0.0, 0.0, 0.0, 0.0
    fx, fy, inverse_z = camera[12], camera[13], 1.0 / out[Z]
    for k in range(3):
        d1, d2 = 0.0, 0.0  # dL/dM[0, k], dL/dM[1, k]
        for j in range(3):
            g_b1 = 2.0 * g_xx * out[B1 + j] + g_xy * out[B2 + j]
            g_b2 = g_xy * out[B1 + j] + 2.0 * g_yy * out[B2 + j]
            factor_grad[k, j] += out[M + k] * g_b1 + out[M + 3 + k] * g_b2
            d1 += g_b1 * factor[k, j]
            d2 += g_b2 * factor[k, j]
        g_m_x += d1 * out[M + k]
        g_m_y += d2 * out[M + 3 + k]
        g_tan_x -= d1 * fx * inverse_z * camera[3 * k + 2]
        g_tan_y -= d2 * fy * inverse_z * camera[3 * k + 2]
    # M scales with 1 / z; the tangents follow the mean only inside the field-of-view margin.
    x, y = out[X], out[Y]
    g_z = -inverse_z * (g_m_x + g_m_y)
    g_x = grad[0] * fx + out[FREE_X] * g_tan_x
    g_y = grad[1] * fy + out[FREE_Y] * g_tan_y
    g_z -= inverse_z * inverse_z * (g_x * x + g_y * y)
    g_x *= inverse_z
    g_y *= inverse_z
    for j in range(3):
        mean_grad[j] += camera[3 * j] * g_x + camera[3 * j + 1] * g_y + camera[3 * j + 2] * g_z


@nb.njit(fastmath=FASTMATH, error_model="numpy", cache=True)
def depth_order(depths, count):
    """(count,) int32 indices that sort `depths[:count]` (positive float64), ties by index: radix passes, then a repair.

    Positive float32 numbers sort like their bits, so three stable passes of 11 bits order the rounded depths; what
    rounding made equal is then sorted run by run.
    """
    keys = np.empty(count, np.float32)
    for i in range(count):
        keys[i] = depths[i]
    bits = keys.view(np.uint32)
    order = np.arange(count).astype(np.int32)
    other = np.empty(count, np.int32)
    for shift in (0, 11, 22):
        starts = np.zeros(2049, np.int64)
        for i in range(count):
            starts[((bits[i] >> shift) & 2047) + 1] += 1
        for digit in range(2048):
            starts[digit + 1] += starts[digit]
        for i in range(count):
            digit = (bits[order[i]] >> shift) & 2047
            other[starts[digit]] = order[i]
            starts[digit] += 1
        order, other = other, order
    start = 0
    for end in range(1, count + 1):
        if end == count or bits[order[end]] != bits[order[start]]:
            _sort_run(depths, order[start:end])
            start = end
    return order


@nb.njit(fastmath=FASTMATH, error_model="numpy", cache=True)
def _sort_run(depths, run):
    """Stable in-place sort of indices by depth: insertion sort, and merge sort for long runs."""
    if len(run) > LONG_RUN:
        run[:] = run[np.argsort(depths[run], kind="mergesort")]
        return
    for i in range(1, len(run)):
        item = run[i]
        j = i
        while j > 0 and depths[run[j - 1]] > depths[item]:
            run[j] = run[j - 1]
            j -= 1
        run[j] = item
