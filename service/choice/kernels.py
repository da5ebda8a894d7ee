"""The compiled loop of the choice: a network of two layers for every candidate, which sees the mean of all."""

from __future__ import annotations

import numpy as np

from ..splat.kernel_cache import kernel


@kernel()
def choose_rows(known, about, into, of_pixel, of_place, own, shared, bias, out, prior, scores):
    """scores (N, K) of known (N, K, F) and about (N, G).

    With first layer `into` (F, h), `of_pixel` (G, h), `of_place` (K, h), second layer `own` and `shared` (h, h) with
    `bias` (h,) and last layer `out` (h,) with `prior` (K,): first = relu(known into + about of_pixel + of_place), score
    = relu(first own + mean over candidates of first shared + bias) out + prior.
    """
    count, places, width = known.shape
    hidden = bias.shape[0]
    first = np.empty((places, hidden), np.float32)
    pixel, mean, second = np.empty(hidden, np.float32), np.empty(hidden, np.float32), np.empty(hidden, np.float32)
    for n in range(count):
        pixel[:] = np.float32(0)
        for g in range(about.shape[1]):
            for h in range(hidden):
                pixel[h] += about[n, g] * of_pixel[g, h]
        mean[:] = np.float32(0)
        for k in range(places):
            for h in range(hidden):
                first[k, h] = pixel[h] + of_place[k, h]
            for f in range(width):
                for h in range(hidden):
                    first[k, h] += known[n, k, f] * into[f, h]
            for h in range(hidden):
                first[k, h] = max(first[k, h], np.float32(0))
                mean[h] += first[k, h] / np.float32(places)
        pixel[:] = bias
        for i in range(hidden):
            for h in range(hidden):
                pixel[h] += mean[i] * shared[i, h]
        for k in range(places):
            second[:] = pixel
            for i in range(hidden):
                for h in range(hidden):
                    second[h] += first[k, i] * own[i, h]
            score = prior[k]
            for h in range(hidden):
                score += max(second[h], np.float32(0)) * out[h]
            scores[n, k] = score
