"""The zip of a scene: the .ply, its document and the renders asked for, byte for byte the same every time."""

from __future__ import annotations

import io
import json
import re
import zipfile
from collections.abc import Mapping, Sequence
from typing import Any

from ..pictures.picture import encode
from ..viewpoints.scene_views import SceneViews
from .drawing import draw
from .runtime import Runtime

_EPOCH = (1980, 1, 1, 0, 0, 0)  # the earliest date that a zip can hold: no clock in the bytes


def zip_bundle(runtime: Runtime, document: Mapping[str, Any], views: Sequence[str]) -> bytes:
    """`scene.ply`, `scene.json` and `renders/view_<spec>.png`; call it on a worker thread."""
    scene_id = document["id"]
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as bundle:
        bundle.writestr(_entry("scene.ply"), runtime.store.ply(scene_id), zipfile.ZIP_DEFLATED, 1)
        bundle.writestr(_entry("scene.json"), json.dumps(document, indent=1), zipfile.ZIP_DEFLATED, 6)
        scene_views = SceneViews.of_document(document)
        for spec in dict.fromkeys(views):
            picture = encode(draw(runtime, scene_id, scene_views.resolve(spec, field="views"), scene_views))
            bundle.writestr(_entry(f"renders/view_{re.sub(r'[^0-9A-Za-z.+-]', '_', spec)}.png"), picture.data)
    return buffer.getvalue()


def _entry(name: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name, _EPOCH)
    entry.external_attr = 0o644 << 16
    return entry
