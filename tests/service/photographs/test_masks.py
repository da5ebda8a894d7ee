"""What masks leave out, by loops over pixels and Gaussians: patches, Gaussians of pixels, and those behind them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.depth_range import DepthRange
from gapmes.service.cameras.rotations import about_axis
from gapmes.service.cameras.world_frame import WorldFrame
from gapmes.service.photographs.images import FittedView
from gapmes.service.photographs.masks import MASKED, TRANSPARENT, UNSEEN, kept_rows, patch_mask

HEIGHT, WIDTH, EXTRA = 6, 8, 200


def views(*kept: np.ndarray | None) -> list[FittedView]:
    """Small photographs beside each other, in a world that is turned and far off, with these masks."""
    found = []
    for index, mask in enumerate(kept):
        pose = np.eye(4)
        pose[:3, :3] = about_axis(np.array([0.0, 0.6, 0.8]), 1.1 + 0.2 * index)
        pose[:3, 3] = 900.0 + 30 * index, -40.0, 7.0
        height, width = (HEIGHT, WIDTH) if mask is None else mask.shape
        camera = Camera.make(width, height, 7.0, 6.0, 0.45 * width, 0.55 * height, pose)
        found.append(FittedView(np.zeros((3, height, width), np.float32), mask, camera, 1.0))
    return found


def speckled(rng: np.random.Generator, height: int = HEIGHT, width: int = WIDTH, share: float = 0.5) -> np.ndarray:
    return rng.random((height, width)) < share


@pytest.mark.parametrize(("height", "width", "rows", "columns"), [(32, 48, 2, 3), (32, 48, 7, 5), (9, 9, 9, 9)])
def test_a_patch_counts_where_it_has_the_centre_of_a_kept_pixel(
    height: int, width: int, rows: int, columns: int
) -> None:
    rng = np.random.default_rng(rows)
    masks = [speckled(rng, height, width, share * rows * columns / (height * width)) for share in (0.5, 0.9)]
    found = patch_mask(views(*masks), rows, columns)
    expected = np.zeros((2, rows, columns), bool)
    for view, mask in enumerate(masks):
        for row, column in np.argwhere(mask):
            down, across = (row + 0.5) * rows / height, (column + 0.5) * columns / width
            expected[view, math.floor(down), math.floor(across)] = True
    np.testing.assert_array_equal(found, expected.reshape(2, -1))
    assert 0 < found[0].sum() < found[0].size
    assert patch_mask(views(None), 2, 2).all()


@pytest.mark.parametrize("masked", [(True, True), (False, True), (False, False)])
def test_gaussians_stay_with_their_pixel_and_the_others_where_a_kept_one_shows_them(masked: tuple[bool, bool]) -> None:
    rng = np.random.default_rng(3)
    masks = [speckled(rng) if each else None for each in masked]
    shots, pixels = views(*masks), 2 * HEIGHT * WIDTH
    frame = WorldFrame.of([view.camera for view in shots], DepthRange(20.0, 90.0, "given"))
    means = rng.uniform(-3, 3, (pixels + EXTRA, 3)).astype(np.float32)
    opacities = rng.random(pixels + EXTRA).astype(np.float32)
    opacities[rng.random(pixels + EXTRA) < 0.2] = 0
    rows, expected = [], dict.fromkeys((TRANSPARENT, MASKED, UNSEEN), 0)
    for row, (mean, opacity) in enumerate(zip(means, opacities, strict=True)):
        reason = TRANSPARENT if opacity == 0 else None
        if reason is None and any(masked):
            if row < pixels:
                view, place = divmod(row, HEIGHT * WIDTH)
                mask = masks[view]
                reason = MASKED if mask is not None and not mask.flat[place] else None
            else:
                world = frame.origin + frame.rotation @ mean.astype(float) * frame.unit
                reason = None if any(shown(view, world) for view in shots) else UNSEEN
        if reason is None:
            rows.append(row)
        else:
            expected[reason] += 1
    found, dropped = kept_rows({"means": means, "opacities": opacities}, shots, frame)
    assert found.tolist() == rows
    assert dropped == {reason: count for reason, count in expected.items() if count}
    assert len(dropped) == (3 if any(masked) else 1)
    every = {"means": means, "opacities": np.ones_like(opacities)}
    assert any(masked) or kept_rows(every, shots, frame)[1] == {}


def shown(view: FittedView, world: np.ndarray) -> bool:
    """Whether a kept pixel of the photograph shows this point."""
    camera = view.camera
    x, y, z = camera.rotation.T @ (world - camera.center)
    if z <= 0:
        return False
    column, row = math.floor(camera.fx * x / z + camera.cx), math.floor(camera.fy * y / z + camera.cy)
    inside = 0 <= column < camera.width and 0 <= row < camera.height
    return inside and (view.mask is None or bool(view.mask[row, column]))
