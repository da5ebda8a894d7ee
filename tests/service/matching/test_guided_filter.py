"""The guided filter against its definition, window by window."""

from __future__ import annotations

import numpy as np

from gapmes.service.matching.guided_filter import EPSILON, RADIUS, GuidedFilter


def test_the_guided_filter_is_its_definition() -> None:
    """Against sums over windows, pixel by pixel (He et al. 2010, equations 5, 6 and 8)."""
    rng = np.random.default_rng(6)
    guide, plane, size = rng.random((9, 11)), rng.random((9, 11)), RADIUS

    def window(values: np.ndarray, y: int, x: int) -> np.ndarray:
        return values[max(y - size, 0) : y + size + 1, max(x - size, 0) : x + size + 1]

    slope, level = np.empty_like(guide), np.empty_like(guide)
    for y, x in np.ndindex(guide.shape):
        g, p = window(guide, y, x), window(plane, y, x)
        slope[y, x] = ((g * p).mean() - g.mean() * p.mean()) / (g.var() + EPSILON)
        level[y, x] = p.mean() - slope[y, x] * g.mean()
    expected = [
        window(slope, y, x).mean() * guide[y, x] + window(level, y, x).mean() for y, x in np.ndindex(guide.shape)
    ]
    assert np.abs(GuidedFilter(guide).of(plane).ravel() - expected).max() < 1e-12
