"""The texture atlas of the scene generator: patterns and photograph crops with mip levels, kept in a cache file."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from tokenize import TokenError
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gapmes.service.process.disk import named, replacing

from .patterns import SIZE, draw
from .photographs import photograph_crop

Split = Literal["train", "validation"]

VERSION = 2  # raise it whenever a pattern or the layout changes: it names the cache file
COUNT = 768
PHOTOGRAPH_EVERY = 3  # every third texture is a crop of a photograph
LEVELS = 6  # 256 px down to 8 px
LEVEL_OFFSETS = tuple(sum((SIZE >> below) ** 2 * 3 for below in range(level)) for level in range(LEVELS))
ROW_BYTES = LEVEL_OFFSETS[-1] + (SIZE >> (LEVELS - 1)) ** 2 * 3
VALIDATION_EVERY = 8  # every eighth texture is never seen in training


@dataclass(frozen=True, eq=False)
class TextureAtlas:
    """`texels` (COUNT, ROW_BYTES) uint8, all mip levels of a texture in one row, finest first; `flat` (COUNT,) bool."""

    texels: NDArray[np.uint8]
    flat: NDArray[np.bool_]

    def indices(self, split: Split) -> NDArray[np.int64]:
        """The textures of a split; the two splits share none."""
        every = np.arange(len(self.texels))
        held_out = every % VALIDATION_EVERY == 0
        return every[held_out if split == "validation" else ~held_out]


def mip_levels(image: NDArray[np.float32]) -> NDArray[np.uint8]:
    """(ROW_BYTES,) all levels of one (SIZE, SIZE, 3) image by repeated 2x2 means."""
    levels = []
    for _ in range(LEVELS):
        levels.append((image * 255 + 0.5).astype(np.uint8).reshape(-1))
        half = image.shape[0] // 2
        image = image.reshape(half, 2, half, 2, 3).mean(axis=(1, 3))
    return np.concatenate(levels)


def build_atlas(seed: int = 0, count: int = COUNT) -> TextureAtlas:
    """Draw the atlas; texture i depends on `seed` and i alone."""
    texels = np.empty((count, ROW_BYTES), np.uint8)
    flat = np.zeros(count, np.bool_)
    for i in range(count):
        rng = np.random.default_rng((VERSION, seed, i))
        if i % PHOTOGRAPH_EVERY == 1:
            image = photograph_crop(rng, held_out=i % VALIDATION_EVERY == 0)
        else:
            image, flat[i] = draw(rng)
        texels[i] = mip_levels(image)
    return TextureAtlas(texels, flat)


def cache_folder() -> Path:
    """`$XDG_CACHE_HOME/gapmes`, else `~/.cache/gapmes`."""
    root = os.environ.get("XDG_CACHE_HOME")
    return (Path(root) if root else Path.home() / ".cache") / "gapmes"


def load_atlas(seed: int = 0) -> TextureAtlas:
    """The atlas of this version and seed, memory-mapped from the cache so that processes share it.

    A missing or damaged cache file is written anew, atomically, as other processes may do at the same time. Raises
    `OSError`.
    """
    path = cache_folder() / f"textures-v{VERSION}-seed{seed}.npy"
    rows = _cached_rows(path)
    if rows is None:
        atlas = build_atlas(seed)
        path.parent.mkdir(parents=True, exist_ok=True)
        with named(path), replacing(path) as part, part.open("wb") as file:
            np.save(file, np.concatenate([atlas.texels, atlas.flat[:, None].astype(np.uint8)], axis=1))
        rows = np.load(path, mmap_mode="r")
    return TextureAtlas(np.asarray(rows)[:, :ROW_BYTES], np.asarray(rows[:, ROW_BYTES]) != 0)


def _cached_rows(path: Path) -> NDArray[np.uint8] | None:
    """(COUNT, ROW_BYTES + 1) texels and `flat` of each texture; None unless the file has this size and type."""
    try:
        rows = np.load(path, mmap_mode="r")
    except (FileNotFoundError, EOFError, ValueError, TokenError):  # all but the first: damaged, or another file
        return None
    return rows if (rows.shape, rows.dtype) == ((COUNT, ROW_BYTES + 1), np.uint8) else None
