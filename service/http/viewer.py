"""A stored scene for the page's WebGL viewer: a .ply in its level frame, and settings with the first view."""

from __future__ import annotations

import math
from contextlib import ExitStack
from typing import IO, Any

import anyio.to_thread
import numpy as np
from fastapi import APIRouter, Request, Response

from ..cameras.camera import Camera
from ..formats.ply import ply_bytes
from ..viewpoints.level_frame import LevelFrame
from ..viewpoints.scene_views import SceneViews
from .files import ASKED_AGAIN, etag_of, etag_of_converted, matches, not_modified
from .responses import PLY, head_alone, json_response
from .runtime import RuntimeDep
from .spilled import SpilledResponse, spilled

router = APIRouter(tags=["scenes"], include_in_schema=False)

_TURNED = np.array([-1.0, -1.0, 1.0])  # the viewer rotates a .ply by 180 degrees about z


@router.head("/scenes/{scene_id}/viewer.ply")
@router.get("/scenes/{scene_id}/viewer.ply")
async def viewer_ply(request: Request, scene_id: str, runtime: RuntimeDep) -> Response:
    """The scene's .ply in its level frame, where float32 positions are precise."""

    def made() -> IO[bytes]:
        frame = _frame(SceneViews.of_document(runtime.store.document(scene_id)))
        return spilled(ply_bytes(frame.gaussians(runtime.store.gaussians(scene_id))), runtime.store.root)

    def tag(held: ExitStack) -> str:
        held.enter_context(runtime.store.keeping(scene_id))
        with runtime.store.reading(scene_id) as path:
            return etag_of_converted(etag_of(path), "viewer.ply")

    with ExitStack() as held:  # until it is made
        etag = await anyio.to_thread.run_sync(tag, held)
        cache = {"ETag": etag, "Cache-Control": ASKED_AGAIN}
        if matches(request, etag):
            return not_modified(cache)
        if request.method == "HEAD":
            return head_alone(PLY, cache)
        return SpilledResponse(await runtime.pictures.run(made, request.is_disconnected), PLY, cache)


@router.head("/scenes/{scene_id}/viewer.json")
@router.get("/scenes/{scene_id}/viewer.json")
def viewer_json(scene_id: str, runtime: RuntimeDep) -> Response:
    """The viewer's settings: the initial camera, and no post-processing."""
    views = SceneViews.of_document(runtime.store.document(scene_id))
    return json_response(viewer_settings(_frame(views).camera(views.cameras[0])))


def viewer_settings(camera: Camera) -> dict[str, Any]:
    """Settings, version 2, that start at a camera given in the frame of the .ply.

    The viewer knows position, target and vertical field of view only: the camera's roll and principal point are lost.
    """
    ahead = camera.rotation[:, 2]
    return {
        "version": 2,
        "tonemapping": "none",
        "highPrecisionRendering": True,
        "background": {"color": [0, 0, 0]},
        "postEffectSettings": {
            "sharpness": {"enabled": False, "amount": 0},
            "bloom": {"enabled": False, "intensity": 0, "blurLevel": 1},
            "grading": {"enabled": False, "brightness": 1, "contrast": 1, "saturation": 1, "tint": [1, 1, 1]},
            "vignette": {"enabled": False, "intensity": 0, "inner": 0, "outer": 1, "curvature": 1},
            "fringing": {"enabled": False, "intensity": 0},
        },
        "animTracks": [],
        "cameras": [
            {
                "initial": {
                    "position": list(_TURNED * camera.center),
                    "target": list(_TURNED * (camera.center + ahead * _distance(camera))),
                    "fov": 2 * math.degrees(math.atan(0.5 * camera.height / camera.fy)),
                }
            }
        ],
        "annotations": [],
        "startMode": "default",
    }


def _distance(camera: Camera) -> float:
    """Depth of the frame's origin, about which the viewer then orbits; 1 if it lies behind the camera."""
    distance = float(-camera.center @ camera.rotation[:, 2])
    return distance if distance > 0 else 1.0


def _frame(views: SceneViews) -> LevelFrame:
    return LevelFrame.of(views.cameras, views.pivot_depth)
