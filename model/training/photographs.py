"""Texture crops from photographs that scikit-image carries: public domain, CC0 or without known restrictions."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow
from skimage import data

from .patterns import SIZE

F32 = NDArray[np.float32]
Rng = np.random.Generator

TRAINING = (
    "astronaut", "brick", "camera", "chelsea", "coins", "grass", "hubble_deep_field", "rocket", "text", "cell",
    "retina", "immunohistochemistry",
)  # fmt: skip
HELD_OUT = ("coffee", "gravel")  # seen by validation alone
SMALLEST_CROP = 90  # px


def photograph_crop(rng: Rng, *, held_out: bool) -> F32:
    """(SIZE, SIZE, 3) in [0, 1]: a random square of a random photograph, turned, mirrored and tinted."""
    photo = _load(str(rng.choice(HELD_OUT if held_out else TRAINING)))
    side = int(np.exp(rng.uniform(np.log(SMALLEST_CROP), np.log(min(*photo.shape[:2], 2 * SIZE) + 1))))
    top, left = (int(rng.integers(0, length - side + 1)) for length in photo.shape[:2])
    crop = photo[top : top + side, left : left + side]
    small = Pillow.fromarray(crop).resize((SIZE, SIZE), Pillow.Resampling.LANCZOS)
    image = np.asarray(small, np.float32) / 255
    if image.ndim == 2:
        low, high = 0.35 * rng.random(3), 1 - 0.35 * rng.random(3)
        image = low + (high - low) * image[..., None]
    image = np.rot90(image, int(rng.integers(4)))
    image = image[:, ::-1] if rng.random() < 0.5 else image
    tinted = np.clip(image * rng.uniform(0.8, 1.2, 3), 0, 1) ** np.exp(rng.uniform(-0.4, 0.4))
    return np.ascontiguousarray(tinted, np.float32)


@cache
def _load(name: str) -> NDArray[np.uint8]:
    return getattr(data, name)()
