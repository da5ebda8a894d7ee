"""A loop over depths and pixels: how much a view differs from another one at each of several depths."""

from __future__ import annotations

import numpy as np

from .splat.access import get, larger, put, smaller
from .splat.kernel_cache import kernel


@kernel()
def compare_levels(own, others, rays, way, lens, levels, limit, found):
    """`found` (D, H, W) mean absolute difference of `own` (H, W, C) and `others` (h, w, C), at most `limit`, where the
    pixel has each of D inverse z-depths, `levels`: seen along ray + level * way, `rays` (H, W, 3) and `way` (3,) in the
    axes of the other view, whose `lens` is fx, fy, cx, cy in px. `limit` where it is behind that or beside it, and
    where what is compared has a NaN."""
    height, width, channels = others.shape
    pixels = rays.size // 3
    share = np.float32(1.0) / np.float32(channels)
    for level in range(levels.size):
        x_way, y_way = get(levels, level) * get(way, 0), get(levels, level) * get(way, 1)
        z_way = get(levels, level) * get(way, 2)
        for at in range(pixels):
            put(found, level * pixels + at, limit)
            z = get(rays, 3 * at + 2) + z_way
            if not z > 0:
                continue
            x = get(lens, 0) * ((get(rays, 3 * at) + x_way) / z) + get(lens, 2)
            y = get(lens, 1) * ((get(rays, 3 * at + 1) + y_way) / z) + get(lens, 3)
            if not (x > 0 and y > 0 and x < width and y < height):
                continue
            x, y = smaller(larger(x - 0.5, 0.0), width - 1.0), smaller(larger(y - 0.5, 0.0), height - 1.0)
            left, upper = np.int64(x), np.int64(y)
            over, down = np.float32(x - left), np.float32(y - upper)
            right, lower = smaller(left + 1, width - 1), smaller(upper + 1, height - 1)
            corners = (upper * width + left) * channels, (upper * width + right) * channels
            below = (lower * width + left) * channels, (lower * width + right) * channels
            before, above = np.float32(1.0) - over, np.float32(1.0) - down
            total = np.float32(0.0)
            for channel in range(channels):
                top = get(others, corners[0] + channel) * before + get(others, corners[1] + channel) * over
                base = get(others, below[0] + channel) * before + get(others, below[1] + channel) * over
                total += abs(top * above + base * down - get(own, at * channels + channel))
            apart = np.float64(total * share)
            if apart < limit:
                put(found, level * pixels + at, apart)
