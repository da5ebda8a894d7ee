"""Photographs from cameras rolled by quarter turns, rotated until all views of a scene have about the same roll.

The network was trained on views of equal roll; one that is rolled by a quarter turn costs up to 5.4 dB. The rotation is
lossless: pixels are permuted and the camera rotates with its photograph, so that rays keep their colours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera
from ..cameras.spanning_tree import minimum_spanning_tree
from .fitting import FittedPhotos
from .images import FittedView, PackedView

HALF_TURN = 2  # quarter turns
CLEARLY = 0.5  # gain in the trace that a turn must bring: a camera rolled by less than 55 degrees stays

_Array = TypeVar("_Array", bound=np.generic)
# the camera's axes after a counterclockwise quarter turn of the picture, in those before: right was down, down left
_QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def quarter_turns(cameras: Sequence[Camera], *, square: bool) -> list[int]:
    """Per view the number of counterclockwise quarter turns, 0 to 3, after which its picture stands as its neighbours'.

    Neighbours are joined by the minimum spanning tree of the camera centres: on a circle around an object each camera
    stands nearly as the next one, and opposite ones do not. Of the solutions, which differ by a common turn, the one
    that turns the fewest views; of several such one that leaves the first view alone. Pictures that are not `square`
    are only turned by 180 degrees, which keeps their shape.
    """
    steps = range(4) if square else (0, HALF_TURN)
    turns: dict[int, int] = {0: 0}
    edges = minimum_spanning_tree(cameras)
    while len(turns) < len(cameras):
        for one, other in edges:
            for known, new in ((one, other), (other, one)):
                if known in turns and new not in turns:
                    turns[new] = (turns[known] + _to_stand_as(cameras[known], cameras[new], steps)) % 4
    found = [turns[index] for index in range(len(cameras))]
    usual = max(found, key=found.count)  # the first of several
    return [(turn - usual) % 4 for turn in found]


def _to_stand_as(camera: Camera, other: Camera, steps: Sequence[int]) -> int:
    """The number of quarter turns of `other`, of `steps`, after which its rotation relative to `camera` has the largest
    trace, hence the least angle; 0 unless that gains CLEARLY."""
    between = camera.rotation.T @ other.rotation
    traces = [float(np.trace(between @ np.linalg.matrix_power(_QUARTER, step))) for step in steps]
    best = int(np.argmax(traces))
    return steps[best] if traces[best] > traces[0] + CLEARLY else 0


def turned_camera(camera: Camera, turns: int) -> Camera:
    """The camera of the picture after so many counterclockwise quarter turns."""
    for _ in range(turns % 4):
        pose = camera.world_from_cam.copy()
        pose[:3, 0], pose[:3, 1] = camera.rotation[:, 1], -camera.rotation[:, 0]
        camera = replace(
            camera,
            width=camera.height,
            height=camera.width,
            fx=camera.fy,
            fy=camera.fx,
            cx=camera.cy,
            cy=camera.width - camera.cx,
            world_from_cam=pose,
        )
    return camera


def turned_view(view: FittedView, turns: int) -> FittedView:
    """`view` with image, mask and camera rotated by so many counterclockwise quarter turns."""
    if turns % 4 == 0:
        return view
    return replace(
        view,
        image=_turned(view.image, turns, (1, 2)),
        mask=None if view.mask is None else _turned(view.mask, turns, (0, 1)),
        camera=turned_camera(view.camera, turns),
    )


def turned_photos(photos: FittedPhotos, turns: Sequence[int]) -> FittedPhotos:
    """Every view rotated by its number of quarter turns; views with 0 stay the same objects."""
    return replace(
        photos,
        seen=[turned_view(view, turn) for view, turn in zip(photos.seen, turns, strict=True)],
        shown=[turned_view(view, turn) for view, turn in zip(photos.shown, turns, strict=True)],
        fine=[_turned_packed(view, turn) for view, turn in zip(photos.fine, turns, strict=True)],
    )


def turned_patches(values: NDArray[_Array], turns: Sequence[int], rows: int) -> NDArray[_Array]:
    """Per-patch `values` (V, P, ...), row by row in `rows` rows per view, reordered as the quarter turns move
    patches."""
    grids = values.reshape(len(values), rows, -1, *values.shape[2:])
    found = [_turned(grid, turn, (0, 1)) for grid, turn in zip(grids, turns, strict=True)]
    return np.stack(found).reshape(values.shape)


def _turned_packed(view: PackedView, turns: int) -> PackedView:
    return PackedView(_turned(view.pixels, turns, (0, 1)), turned_camera(view.camera, turns)) if turns % 4 else view


def _turned(pixels: NDArray[_Array], turns: int, axes: tuple[int, int]) -> NDArray[_Array]:
    return np.ascontiguousarray(np.rot90(pixels, turns, axes))
