"""Numba blending of projected Gaussians, front to back (Eq. 19-20), and its gradient; one image per thread."""

from __future__ import annotations

import math

import numba as nb
import numpy as np

from .splat_projection import (
    COLUMN_STD,
    FASTMATH,
    ROW_STD,
    SCRATCH,
    SHEAR,
    U,
    V,
    depth_of,
    depth_order,
    project_gaussian,
    project_gaussian_backward,
)

ALPHA_MIN = 1.0 / 255.0  # a fainter splat moves an 8-bit pixel by less than one level
ALPHA_MAX = np.float32(0.99)
STOP = np.float32(1e-4)  # the Gaussian that brings the transmittance to or below this is the last one added
ONE, HALF, ZERO = np.float32(1.0), np.float32(0.5), np.float32(0.0)

# Columns of a record: what the pixel loops need of one visible Gaussian, in depth order.
REC_U, REC_V, REC_SHEAR, REC_COLUMN, REC_ROW, REC_CUT, REC_HEIGHT, REC_OPACITY, REC_COLOUR = 0, 1, 2, 3, 4, 5, 6, 7, 8
RECORD = 11
# Columns of the image gradient of one visible Gaussian: u, v, shear, S_ss, S_tt, opacity, r, g, b.
IMAGE_GRAD = 9
Sum = float | np.float32  # to a type checker; numba makes it a float64


@nb.njit(fastmath=FASTMATH, error_model="numpy", cache=True)
def _gather(means, factors, opacities, colours, camera, height, width, near, dilation, records, indices):
    """Project, cull and sort one scene for one camera; returns how many records were written."""
    count = means.shape[0]
    out = np.empty(SCRATCH, np.float64)
    found = np.empty(count, np.int32)
    depths = np.empty(count, np.float64)
    rows = np.empty((count, 7), np.float64)
    visible = 0
    for i in range(count):
        z = depth_of(means[i], camera)
        if not (z > near and opacities[i] > ALPHA_MIN):
            continue
        project_gaussian(means[i], factors[i], camera, width, height, dilation, out)
        cut = 2.0 * math.log(255.0 * opacities[i])
        reach = math.sqrt(cut)
        half_height = reach * out[ROW_STD]
        sheared = out[SHEAR] * out[ROW_STD]
        half_width = reach * math.sqrt(out[COLUMN_STD] * out[COLUMN_STD] + sheared * sheared)
        u, v = out[U], out[V]
        if u + half_width < 0.5 or u - half_width > width - 0.5:
            continue
        if v + half_height < 0.5 or v - half_height > height - 0.5:
            continue
        row = rows[visible]
        row[0], row[1], row[2], row[5], row[6] = u, v, out[SHEAR], cut, half_height
        row[3], row[4] = 1.0 / out[COLUMN_STD], 1.0 / out[ROW_STD]
        found[visible], depths[visible] = i, z
        visible += 1
    order = depth_order(depths, visible)
    for n in range(visible):
        i = found[order[n]]
        record = records[n]
        for k in range(7):
            record[k] = rows[order[n], k]
        record[REC_OPACITY] = opacities[i]
        for k in range(3):
            record[REC_COLOUR + k] = colours[i, k]
        indices[n] = i
    return visible


@nb.njit(fastmath=FASTMATH, error_model="numpy", cache=True)
def _span(record, y, width):
    """The pixels [first, last] of row y inside the alpha cut, with t at the first one and s^2 of the row."""
    dy = y + 0.5 - record[REC_V]
    s = dy * record[REC_ROW]
    rest = record[REC_CUT] - s * s
    if rest <= 0.0:
        return 0, -1, 0.0, 0.0
    centre = record[REC_U] + record[REC_SHEAR] * dy - 0.5
    half = math.sqrt(rest) / record[REC_COLUMN]
    first = math.ceil(max(centre - half, 0.0))
    last = math.floor(min(centre + half, width - 1.0))
    return first, last, (first - centre) * record[REC_COLUMN], s


@nb.njit(fastmath=FASTMATH, error_model="numpy", cache=True)
def _blend(records, visible, background, rgb, transmittances, last_used):
    """Composite one image; `last_used` (H, W) gets one plus the position of the last Gaussian that each pixel took."""
    height, width = transmittances.shape
    pixels = np.zeros((height, width, 4), np.float32)  # r, g, b, transmittance
    pixels[:, :, 3] = ONE
    for n in range(visible):
        record = records[n]
        top = math.ceil(max(record[REC_V] - record[REC_HEIGHT] - 0.5, 0.0))
        bottom = math.floor(min(record[REC_V] + record[REC_HEIGHT] - 0.5, height - 1.0))
        opacity, step = np.float32(record[REC_OPACITY]), np.float32(record[REC_COLUMN])
        red, green = np.float32(record[REC_COLOUR]), np.float32(record[REC_COLOUR + 1])
        blue = np.float32(record[REC_COLOUR + 2])
        for y in range(top, bottom + 1):
            first, last, t_first, s = _span(record, y, width)
            t_start, ss = np.float32(t_first), np.float32(s * s)
            for x in range(first, last + 1):
                pixel = pixels[y, x]
                transmittance = pixel[3]
                if transmittance <= STOP:
                    continue
                t = t_start + np.float32(x - first) * step
                a = min(ALPHA_MAX, opacity * math.exp(-HALF * (ss + t * t)))
                weight = a * transmittance
                pixel[0] += weight * red
                pixel[1] += weight * green
                pixel[2] += weight * blue
                pixel[3] = transmittance - weight
                last_used[y, x] = n + 1
    for y in range(height):
        for x in range(width):
            transmittance = pixels[y, x, 3]
            for k in range(3):
                rgb[k, y, x] = pixels[y, x, k] + transmittance * background[k]
            transmittances[y, x] = transmittance


@nb.njit(fastmath=FASTMATH, error_model="numpy", cache=True)
def _blend_backward(records, visible, background, transmittances, last_used, rgb_grad, alpha_grad, image_grads):
    """Write dL/d(record) of every visible Gaussian of one image to `image_grads` (visible, IMAGE_GRAD)."""
    height, width = transmittances.shape
    pixels = np.empty((height, width, 5), np.float32)  # dL/dr, dL/dg, dL/db, sum over what lies behind, transmittance
    for y in range(height):
        for x in range(width):
            transmittance = transmittances[y, x]
            behind = -alpha_grad[y, x]
            for k in range(3):
                pixels[y, x, k] = rgb_grad[k, y, x]
                behind += rgb_grad[k, y, x] * background[k]
            pixels[y, x, 3] = behind * transmittance
            pixels[y, x, 4] = transmittance
    for n in range(visible - 1, -1, -1):
        record = records[n]
        top = math.ceil(max(record[REC_V] - record[REC_HEIGHT] - 0.5, 0.0))
        bottom = math.floor(min(record[REC_V] + record[REC_HEIGHT] - 0.5, height - 1.0))
        opacity, step = np.float32(record[REC_OPACITY]), np.float32(record[REC_COLUMN])
        red, green = np.float32(record[REC_COLOUR]), np.float32(record[REC_COLOUR + 1])
        blue = np.float32(record[REC_COLOUR + 2])
        sum_s, sum_ss, sum_t, sum_tt, sum_t_dy, sum_h = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0  # type: Sum, Sum, Sum, Sum, Sum, Sum
        sum_red, sum_green, sum_blue = 0.0, 0.0, 0.0  # type: Sum, Sum, Sum
        for y in range(top, bottom + 1):
            first, last, t_first, s = _span(record, y, width)
            t_start, ss = np.float32(t_first), np.float32(s * s)
            row_h, row_th, row_tth = ZERO, ZERO, ZERO
            row_red, row_green, row_blue = ZERO, ZERO, ZERO
            for x in range(first, last + 1):
                if n >= last_used[y, x]:
                    continue
                pixel = pixels[y, x]
                t = t_start + np.float32(x - first) * step
                a = opacity * math.exp(-HALF * (ss + t * t))
                clamped = a > ALPHA_MAX
                a = min(ALPHA_MAX, a)
                inverse = ONE / (ONE - a)
                transmittance = pixel[4] * inverse
                weight = a * transmittance
                towards = pixel[0] * red + pixel[1] * green + pixel[2] * blue
                row_red += weight * pixel[0]
                row_green += weight * pixel[1]
                row_blue += weight * pixel[2]
                # h = alpha dL/dalpha, the gradient of the exponent
                h = ZERO if clamped else a * (towards * transmittance - pixel[3] * inverse)
                pixel[3] += towards * weight
                pixel[4] = transmittance
                row_h += h
                row_th += h * t
                row_tth += h * t * t
            sum_h += row_h
            sum_s += s * row_h
            sum_ss += s * s * row_h
            sum_t += row_th
            sum_tt += row_tth
            sum_t_dy += row_th * (y + 0.5 - record[REC_V])
            sum_red += row_red
            sum_green += row_green
            sum_blue += row_blue
        grad = image_grads[n]
        grad[0] = record[REC_COLUMN] * sum_t
        grad[1] = record[REC_ROW] * sum_s - record[REC_SHEAR] * record[REC_COLUMN] * sum_t
        grad[2] = record[REC_COLUMN] * sum_t_dy
        grad[3], grad[4] = sum_ss, sum_tt
        grad[5] = sum_h / opacity
        grad[6], grad[7], grad[8] = sum_red, sum_green, sum_blue


@nb.njit(parallel=True, fastmath=FASTMATH, error_model="numpy", cache=True)
def splat_forward(
    means, factors, opacities, colours, cameras, background, near, dilation,
    rgb, transmittances, records, indices, visible, last_used,
):  # fmt: skip
    """All images of a batch; `cameras` (B, T, 16), outputs and what the backward pass needs have B*T rows."""
    views = cameras.shape[1]
    height, width = transmittances.shape[1:]
    for image in nb.prange(cameras.shape[0] * views):
        scene, view = image // views, image % views
        visible[image] = _gather(
            means[scene], factors[scene], opacities[scene], colours[scene], cameras[scene, view],
            height, width, near, dilation, records[image], indices[image],
        )  # fmt: skip
        _blend(records[image], visible[image], background, rgb[image], transmittances[image], last_used[image])


@nb.njit(parallel=True, fastmath=FASTMATH, error_model="numpy", cache=True)
def splat_backward_images(background, transmittances, records, visible, last_used, rgb_grad, alpha_grad, image_grads):
    """First half of the gradient: per image, in image space."""
    for image in nb.prange(transmittances.shape[0]):
        _blend_backward(
            records[image], visible[image], background, transmittances[image], last_used[image],
            rgb_grad[image], alpha_grad[image], image_grads[image],
        )  # fmt: skip


@nb.njit(parallel=True, fastmath=FASTMATH, error_model="numpy", cache=True)
def splat_backward_scenes(
    means, factors, cameras, height, width, dilation, indices, visible, image_grads,
    mean_grads, factor_grads, opacity_grads, colour_grads,
):  # fmt: skip
    """Second half: per scene, gathers its images in a fixed order into float64 gradients that start at zero."""
    views = cameras.shape[1]
    for scene in nb.prange(cameras.shape[0]):
        out = np.empty(SCRATCH, np.float64)
        for view in range(views):
            image = scene * views + view
            for n in range(visible[image]):
                i = indices[image, n]
                grad = image_grads[image, n]
                factor = factors[scene, i]
                project_gaussian(means[scene, i], factor, cameras[scene, view], width, height, dilation, out)
                project_gaussian_backward(
                    factor, cameras[scene, view], out, grad, mean_grads[scene, i], factor_grads[scene, i]
                )
                opacity_grads[scene, i] += grad[5]
                for k in range(3):
                    colour_grads[scene, i, k] += grad[6 + k]
