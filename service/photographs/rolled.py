"""Photographs that were taken with the camera rolled: turned by quarter turns until all of a scene stand alike.

The network was trained on cameras that stand alike, and one rolled by quarters beside others costs it up to 5.4 dB.
A turn moves pixels and changes none, and the camera turns with its photograph: the same rays have the same colours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera
from ..cameras.shortest_ways import shortest_ways
from .fitting import FittedPhotos
from .images import FittedView, PackedView

UPSIDE_DOWN = 2  # quarter turns
CLEARLY = 0.5  # of the trace: a camera rolled by less than 55 degrees stands nearly as well as it is

_Array = TypeVar("_Array", bound=np.generic)
# the camera's axes after one quarter turn of the picture against the clock, in those before: right was down, down left
_QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def quarter_turns(cameras: Sequence[Camera], *, square: bool) -> list[int]:
    """How often each picture is to be turned by 90 degrees against the clock, 0 to 3, to stand as its neighbours do.

    Neighbours are those of the shortest ways that join all cameras: on a circle about a thing each stands nearly as the
    next, and those opposite do not. Of all ways to turn them the one that turns fewest, of several one that leaves the
    first. Pictures that are not `square` keep their shape, which leaves half a turn.
    """
    steps = range(4) if square else (0, UPSIDE_DOWN)
    cameras = [replace(camera) for camera in cameras]  # each an object of its own, also where one is given twice
    turns: dict[int, int] = {0: 0}
    place = {id(camera): index for index, camera in enumerate(cameras)}
    ways = [(place[id(one)], place[id(other)]) for one, other in shortest_ways(cameras)]
    while len(turns) < len(cameras):
        for one, other in ways:
            for known, new in ((one, other), (other, one)):
                if known in turns and new not in turns:
                    turns[new] = (turns[known] + _to_stand_as(cameras[known], cameras[new], steps)) % 4
    found = [turns[index] for index in range(len(cameras))]
    usual = max(found, key=found.count)  # the first of several
    return [(turn - usual) % 4 for turn in found]


def _to_stand_as(camera: Camera, other: Camera, steps: Sequence[int]) -> int:
    """The turn of `other` after which the rotation to it has the largest trace, so the least angle; 0 unless clearly
    so."""
    between = camera.rotation.T @ other.rotation
    traces = [float(np.trace(between @ np.linalg.matrix_power(_QUARTER, step))) for step in steps]
    best = int(np.argmax(traces))
    return steps[best] if traces[best] > traces[0] + CLEARLY else 0


def turned_camera(camera: Camera, turns: int) -> Camera:
    """The camera of the picture after so many quarter turns against the clock."""
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
    """The same with camera, colours and mask turned."""
    if turns % 4 == 0:
        return view
    return replace(
        view,
        image=_turned(view.image, turns, (1, 2)),
        mask=None if view.mask is None else _turned(view.mask, turns, (0, 1)),
        camera=turned_camera(view.camera, turns),
    )


def turned_photos(photos: FittedPhotos, turns: Sequence[int]) -> FittedPhotos:
    """Each of its views turned so often; those that are not stay the same objects."""
    return replace(
        photos,
        seen=[turned_view(view, turn) for view, turn in zip(photos.seen, turns, strict=True)],
        shown=[turned_view(view, turn) for view, turn in zip(photos.shown, turns, strict=True)],
        fine=[_turned_packed(view, turn) for view, turn in zip(photos.fine, turns, strict=True)],
    )


def turned_patches(values: NDArray[_Array], turns: Sequence[int], rows: int) -> NDArray[_Array]:
    """(V, P, ...) values of patches, in `rows` rows each view, in the order that they have after so many turns."""
    grids = values.reshape(len(values), rows, -1, *values.shape[2:])
    found = [_turned(grid, turn, (0, 1)) for grid, turn in zip(grids, turns, strict=True)]
    return np.stack(found).reshape(values.shape)


def _turned_packed(view: PackedView, turns: int) -> PackedView:
    return PackedView(_turned(view.pixels, turns, (0, 1)), turned_camera(view.camera, turns)) if turns % 4 else view


def _turned(pixels: NDArray[_Array], turns: int, axes: tuple[int, int]) -> NDArray[_Array]:
    return np.ascontiguousarray(np.rot90(pixels, turns, axes))
