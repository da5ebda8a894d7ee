"""A stored scene for the page's WebGL viewer: upright about its pivot, with settings that look from its first view."""

from __future__ import annotations

import math
from typing import IO, Annotated, Any

import anyio.to_thread
import numpy as np
from fastapi import APIRouter, Depends, Request, Response

from ..cameras.camera import Camera
from ..formats.ply import ply_bytes
from ..viewpoints.level_frame import LevelFrame
from ..viewpoints.scene_views import SceneViews
from .files import ASKED_AGAIN, etag_of, matches, not_modified
from .responses import PLY, head_alone, json_response
from .runtime import Runtime, runtime_of
from .spilled import SpilledResponse, spilled

router = APIRouter(tags=["scenes"], include_in_schema=False)

Held = Annotated[Runtime, Depends(runtime_of)]

_TURNED = np.array([-1.0, -1.0, 1.0])  # the viewer turns a .ply by half a turn about z


@router.head("/scenes/{scene_id}/viewer.ply")
@router.get("/scenes/{scene_id}/viewer.ply")
async def viewer_ply(request: Request, scene_id: str, runtime: Held) -> Response:
    """The scene's .ply in its level frame, float32 near the origin."""

    def made() -> IO[bytes]:
        frame = _frame(SceneViews.of_document(runtime.store.document(scene_id)))
        return spilled(ply_bytes(frame.gaussians(runtime.store.gaussians(scene_id))), runtime.store.root)

    def tag() -> str:
        with runtime.store.reading(scene_id) as path:
            return f"W/{etag_of(path)}"

    etag = await anyio.to_thread.run_sync(tag)
    cache = {"ETag": etag, "Cache-Control": ASKED_AGAIN}
    if matches(request, etag):
        return not_modified(etag, cache)
    if request.method == "HEAD":
        return head_alone(PLY, cache)
    body = await runtime.pictures.run(made, request.is_disconnected)
    return SpilledResponse(body, PLY, cache)


@router.head("/scenes/{scene_id}/viewer.json")
@router.get("/scenes/{scene_id}/viewer.json")
def viewer_json(scene_id: str, runtime: Held) -> Response:
    """The viewer's settings: where it begins, and that it adds nothing of its own to the picture."""
    views = SceneViews.of_document(runtime.store.document(scene_id))
    return json_response(viewer_settings(_frame(views).camera(views.cameras[0])))


def viewer_settings(camera: Camera) -> dict[str, Any]:
    """Settings, version 2, that begin at a camera of the .ply's own frame.

    The viewer looks from a position to a target, upright, with square pixels: a roll of the camera and an offset of its
    principal point cannot be said.
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
    """How far ahead the frame's origin lies, which the viewer then turns about; 1 where it lies behind."""
    distance = float(-camera.center @ camera.rotation[:, 2])
    return distance if distance > 0 else 1.0


def _frame(views: SceneViews) -> LevelFrame:
    return LevelFrame.of(views.cameras, views.pivot_depth)
