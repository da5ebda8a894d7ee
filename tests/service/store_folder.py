"""Entries of a store's folder beside its own files, documents that a store takes for whole, and Gaussians."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from gapmes.service.gaussians import Gaussians


def names(root: Path) -> set[str]:
    """Of scenes, and of leftovers, of which there should be none."""
    return {path.name for path in root.iterdir() if not path.name.startswith(("index.sqlite", ".lock", ".writing"))}


CAMERA = {name: 1 for name in ("width", "height", "fx", "fy", "cx", "cy", "c2w")}


def document(scene_id: str, **more: Any) -> dict[str, Any]:
    """What the service reads of a scene's document, and `more`."""
    empty = {"gaussians": {}, "view_cameras": [], "warnings": [], "timings": {}, "near": None, "far": None}
    return {"id": scene_id, **empty, **more}


def gaussians(count: int = 5, seed: int = 0) -> Gaussians:
    rng = np.random.default_rng(seed)
    return Gaussians.make(
        rng.normal(size=(count, 3)),
        rng.uniform(0.1, 1, (count, 3)),
        rng.normal(size=(count, 4)),
        rng.uniform(0.1, 0.9, count),
        rng.normal(size=(count, 1, 3)),
    )
