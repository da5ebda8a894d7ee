"""The stability row of matching between views: bright and dark pictures with little contrast."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch

from gapmes.model.cost_volume import Views
from gapmes.model.evidence import matching_evidence

from . import naive
from .row import Row, larger

SIZE = 40  # px
LEVELS = (0.05, 0.5, 0.95, (0.05, 0.95))  # the last: dark and bright halves
CONTRASTS = (0.2, 0.05, 0.01)  # largest difference from the level


def rows() -> Iterator[Row]:
    """Case by case."""
    yield evidence()


def evidence() -> Row:
    """Two cameras of one pose: on every plane the pictures are compared pixel by pixel, so that only the window means
    round."""
    rng = np.random.default_rng(0)
    views = Views.make(
        torch.tensor([[1.0, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1]]).expand(1, 2, 3, 3),
        torch.eye(4).expand(1, 2, 4, 4),
        torch.tensor([[1.0, 8.0]]),
    )
    worst = plain = 0.0
    for level in LEVELS:
        for contrast in CONTRASTS:
            texture = rng.uniform(-1, 1, (3, SIZE, SIZE))
            both = np.stack([texture, 0.7 * texture + 0.3 * rng.uniform(-1, 1, texture.shape)])
            images = np.clip(np.repeat(level, SIZE // np.size(level)) + contrast * both, 0, 1).astype(np.float32)
            exact = naive.evidence(*images.astype(np.float64))
            found = matching_evidence(torch.from_numpy(images), views, 2)[0, 0].numpy()
            worst = larger(worst, float(np.abs(found - exact).max()))
            plain = larger(plain, float(np.abs(naive.evidence(*images) - exact).max()))
    sweep = f"levels 0.05 to 0.95, both in one, contrasts {CONTRASTS[-1]} to {CONTRASTS[0]}"
    return Row("P11", "evidence of matching", sweep, "float64", "score", worst, 1e-5, plain, "squares about zero")
