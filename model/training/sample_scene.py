"""Render the sample scene that ships with the service: `python -m gapmes.model.training.sample_scene OUT_DIR`."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from PIL import Image

from .primitives import pack
from .rotations import look_at
from .still_life import still_life, still_life_atlas
from .trace import trace

SIZE = 256  # px
SUPERSAMPLE = 4
FOCAL = 265.0  # px: a field of view of 52 degrees
SPACING = 0.15  # metres between neighbouring cameras
AIM = np.array([0.03, -0.93, 2.7])
SUGGESTED = {"context2": [1, 5], "target2": [2, 3, 4, 6], "context3": [0, 3, 7], "target3": [1, 2, 5, 6]}


def camera_poses() -> NDArray[np.float64]:
    """(8, 4, 4) world_from_cam: a gentle arc that rises and falls, everybody looking towards the table."""
    poses = np.tile(np.eye(4), (8, 1, 1))
    for i, pose in enumerate(poses):
        across = (i - 3.5) * SPACING
        centre = np.array([across, -1.32 + 0.06 * math.sin(1.7 * i), 0.12 + 0.15 * across**2])
        pose[:3, :3] = look_at(centre, AIM + 0.3 * across * np.array([1.0, 0.0, 0.0]))
        pose[:3, 3] = centre
    return poses.round(9)


def render_sample() -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.float64]]:
    """Images (8, SIZE, SIZE, 3) uint8, z-depths (8, SIZE, SIZE) in metres and poses (8, 4, 4)."""
    poses = camera_poses()
    lens = np.broadcast_to([FOCAL, FOCAL, SIZE / 2, SIZE / 2], (len(poses), 4))
    rows = np.concatenate([poses[:, :3, :3].reshape(-1, 9), poses[:, :3, 3], lens], axis=1)
    images, depths = trace(still_life_atlas(), pack([still_life()]), rows[None], SIZE, SIZE, SUPERSAMPLE)
    pixels = (np.clip(images[0], 0, 1) * 255 + 0.5).astype(np.uint8).transpose(0, 2, 3, 1)
    return np.ascontiguousarray(pixels), depths[0], poses


def camera_document(depths: NDArray[np.float32], poses: NDArray[np.float64]) -> dict[str, Any]:
    """The camera file of the scene; near and far leave a margin around what the cameras see."""
    lens = {"width": SIZE, "height": SIZE, "fx": FOCAL, "fy": FOCAL, "cx": SIZE / 2, "cy": SIZE / 2}
    return {
        "name": "still life",
        "licence": "MIT, made by this project",
        "near": round(0.8 * float(depths.min()), 3),
        "far": round(1.25 * float(depths.max()), 3),
        "suggested": SUGGESTED,
        "views": [{"image": f"images/{i:03d}.png", **lens, "c2w": pose.tolist()} for i, pose in enumerate(poses)],
    }


def main(out_dir: Annotated[Path, typer.Argument(help="Folder for cameras.json and images/.")]) -> None:
    """Render the sample scene into a folder."""
    try:
        (out_dir / "images").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise typer.BadParameter(f"{out_dir} cannot be the folder of a scene: {error.strerror}") from error
    pixels, depths, poses = render_sample()
    for i, image in enumerate(pixels):
        Image.fromarray(image).save(out_dir / "images" / f"{i:03d}.png", optimize=True)
    text = json.dumps(camera_document(depths, poses), indent=1)
    (out_dir / "cameras.json").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    typer.run(main)
