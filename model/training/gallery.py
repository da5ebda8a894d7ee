"""A picture of what training sees: generated scenes with their depth, one pair of views each."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray
from PIL import Image

from .scenes import SceneSampler

F32 = NDArray[np.float32]


def gallery(rows: int, columns: int, size: int, seed: int) -> NDArray[np.uint8]:
    """(rows * size, columns * 3 * size, 3): first input, second input and the first one's inverse depth of each."""
    sampler = SceneSampler(seed, "train")
    scenes = [sampler.batch(1, 2, 1, size) for _ in range(rows * columns)]
    tiles = [
        np.concatenate([*scene.images[0, :2].transpose(0, 2, 3, 1), _coloured(scene.depths[0, 0])], axis=1)
        for scene in scenes
    ]
    lines = [np.concatenate(tiles[row * columns : (row + 1) * columns], axis=1) for row in range(rows)]
    return (np.concatenate(lines) * 255 + 0.5).astype(np.uint8)


def _coloured(depth: F32) -> F32:
    """(H, W, 3): bright is near."""
    inverse = 1 / depth
    low, high = np.percentile(inverse, (1, 99))
    return colormaps["magma"](np.clip((inverse - low) / max(high - low, 1e-12), 0, 1))[..., :3].astype(np.float32)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m gapmes.model.training.gallery", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="picture to write")
    parser.add_argument("--rows", type=int, default=4)
    parser.add_argument("--columns", type=int, default=3)
    parser.add_argument("--size", type=int, default=112, help="px per view")
    parser.add_argument("--seed", type=int, default=4)
    options = parser.parse_args(arguments)
    Image.fromarray(gallery(options.rows, options.columns, options.size, options.seed)).save(options.out, quality=88)


if __name__ == "__main__":
    main()
