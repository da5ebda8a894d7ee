"""A picture of what training sees: generated scenes with their depth, one pair of views each."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray
from PIL import Image

from .arguments import seed as any_seed
from .arguments import whole_number
from .scenes import SceneSampler

F32 = NDArray[np.float32]


def gallery(rows: int, columns: int, size: int, seed: int) -> NDArray[np.uint8]:
    """(rows * size, columns * 3 * size, 3): first input, second input and the first one's inverse depth of each; in
    scenes of this seed."""
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


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m gapmes.model.training.gallery", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="picture to write")
    parser.add_argument("--rows", type=whole_number(1), default=4)
    parser.add_argument("--columns", type=whole_number(1), default=3)
    parser.add_argument("--size", type=whole_number(16), default=112, help="px per view")
    parser.add_argument("--seed", type=any_seed(), default=4)
    options = parser.parse_args(arguments)
    try:
        picture = Image.fromarray(gallery(options.rows, options.columns, options.size, options.seed))
    except OSError as error:  # of the textures' cache
        sys.stderr.write(f"refused: {error}\n")
        return 1
    try:
        picture.save(options.out, quality=88)
    except (OSError, ValueError) as error:  # of a suffix that is no picture's
        sys.stderr.write(f"refused: {options.out} cannot be written: {error}; name another place\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
