"""The zip of a scene: its .ply, its document and the requested renders; reproducible byte by byte."""

from __future__ import annotations

import io
import json
import re
import zipfile
from collections.abc import Mapping, Sequence
from typing import IO, Any

from ..pictures.picture import png
from ..viewpoints.scene_views import SceneViews
from .concurrency import Gone, Pause
from .drawing import PictureSeries
from .runtime import Runtime
from .spilled import spilled

_EPOCH = (1980, 1, 1, 0, 0, 0)  # the earliest date of a zip: a time stamp would change the bytes


async def zip_bundle(runtime: Runtime, document: Mapping[str, Any], views: Sequence[str], gone: Gone) -> IO[bytes]:
    """`scene.ply`, `scene.json` and `renders/view_<spec>.png`, drawn one by one in the queue of pictures and packed in
    that of files. The caller keeps the scene from eviction."""
    scene_views = SceneViews.of_document(document)
    cameras = {spec: scene_views.resolve(spec, field="views") for spec in views}

    def drawn(pause: Pause) -> dict[str, bytes]:
        series = PictureSeries(runtime, document["id"], scene_views, None, pause)
        return {spec: png(series.pixels(camera)) for spec, camera in cameras.items()}

    pictures = await runtime.pictures.run_in_steps(drawn, gone) if cameras else {}
    return await runtime.files.run(lambda: spilled(_packed(runtime, document, pictures), runtime.store.root), gone)


def _packed(runtime: Runtime, document: Mapping[str, Any], pictures: Mapping[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as bundle:
        bundle.writestr(_entry("scene.ply"), runtime.store.ply(document["id"]), zipfile.ZIP_DEFLATED, 1)
        bundle.writestr(_entry("scene.json"), json.dumps(document, indent=1), zipfile.ZIP_DEFLATED, 6)
        for spec, data in pictures.items():
            bundle.writestr(_entry(f"renders/view_{re.sub(r'[^0-9A-Za-z.+-]', '_', spec)}.png"), data)
    return buffer.getvalue()


def _entry(name: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name, _EPOCH)
    entry.external_attr = 0o644 << 16
    return entry
