"""Views of the sample scene on the network's grid."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np
from PIL import Image

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.camera_file import parse_camera_file
from gapmes.service.photographs.images import FittedView, Photo, fit_view
from gapmes.service.shipped import sample_folder

NEAR, FAR = 1.647, 4.809


def sample_pixels(index: int) -> np.ndarray:
    """uint8 (H, W, 3) of a photograph."""
    return np.asarray(Image.open(sample_folder() / f"images/{index:03d}.png"))


def sample_cameras(indices: Sequence[int]) -> list[Camera]:
    listed = parse_camera_file(json.loads((sample_folder() / "cameras.json").read_text())).views
    return [listed[index].camera for index in indices]


def sample_views(indices: Sequence[int]) -> list[FittedView]:
    photos = [Photo.from_array(sample_pixels(index)) for index in indices]
    return [fit_view(photo, c, 256, 256) for photo, c in zip(photos, sample_cameras(indices), strict=True)]
