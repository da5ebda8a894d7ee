"""The compiled forward pass of the choice network: a two-layer MLP per candidate, with mean pooling over candidates."""

from __future__ import annotations

import numpy as np

from ...splat.access import get, larger, put
from ...splat.kernel_cache import kernel


@kernel()
def choose_rows(known, about, into, of_pixel, of_place, own, shared, bias, out, prior, scores):
    """Scores (N, K) of K candidates of each pixel, from candidate features `known` (N, K, F) and pixel features `about`
    (N, G).

    With first layer `into` (F, h), `of_pixel` (G, h), `of_place` (K, h), second layer `own` and `shared` (h, h) with
    `bias` (h,) and last layer `out` (h,) with `prior` (K,): first = relu(known into + about of_pixel + of_place), score
    = relu(first own + mean over candidates of first shared + bias) out + prior.
    """
    count, places, width = known.shape
    hidden, depth = bias.shape[0], about.shape[1]
    first = np.empty(places * hidden, np.float32)
    pixel, mean, second = np.empty(hidden, np.float32), np.empty(hidden, np.float32), np.empty(hidden, np.float32)
    for n in range(count):
        pixel[:] = np.float32(0)
        mean[:] = np.float32(0)
        _add_product(about, n * depth, depth, of_pixel, pixel, 0)
        for k in range(places):
            start = k * hidden
            for h in range(hidden):
                put(first, start + h, get(pixel, h) + get(of_place, start + h))
            _add_product(known, (n * places + k) * width, width, into, first, start)
            for h in range(hidden):
                put(first, start + h, larger(get(first, start + h), np.float32(0)))
                put(mean, h, get(mean, h) + get(first, start + h) / np.float32(places))
        pixel[:] = bias
        _add_product(mean, 0, hidden, shared, pixel, 0)
        for k in range(places):
            second[:] = pixel
            _add_product(first, k * hidden, hidden, own, second, 0)
            score = get(prior, k)
            for h in range(hidden):
                score += larger(get(second, h), np.float32(0)) * get(out, h)
            put(scores, n * places + k, score)


@kernel()
def _add_product(values, at, count, weights, sums, start):
    """Add the product of `count` of `values` from `at` on and `weights` (count, h) to h of `sums` from `start` on.

    Four rows of `weights` per pass, which reads and writes the sums a quarter as often, in the same order of addition.
    """
    hidden = weights.shape[1]
    whole = count // 4 * 4
    for i in range(0, whole, 4):
        a, b, c, d = get(values, at + i), get(values, at + i + 1), get(values, at + i + 2), get(values, at + i + 3)
        row = i * hidden
        for h in range(hidden):
            total = get(sums, start + h) + a * get(weights, row + h) + b * get(weights, row + hidden + h)
            total = total + c * get(weights, row + 2 * hidden + h) + d * get(weights, row + 3 * hidden + h)
            put(sums, start + h, total)
    for i in range(whole, count):
        a = get(values, at + i)
        for h in range(hidden):
            put(sums, start + h, get(sums, start + h) + a * get(weights, i * hidden + h))
