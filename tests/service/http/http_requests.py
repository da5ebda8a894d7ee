"""Well-formed requests for tests to modify, and the form of every refusal."""

from __future__ import annotations

import io
import json
import time
from typing import Any

import numpy as np
from PIL import Image
from starlette.testclient import TestClient

from gapmes.service.settings import Settings

MAX_UPLOAD = 2_000_000  # bytes; small, so that the tests for it stay small


def wait_until_ready(client: TestClient) -> dict[str, Any]:
    deadline = time.monotonic() + 300  # the kernels may have to be compiled first
    while (answer := client.get("/readyz")).status_code != 200:
        assert answer.json()["state"] == "starting", answer.text
        assert time.monotonic() < deadline, "not ready in time"
        time.sleep(0.05)
    return answer.json()


def photograph(seed: int = 0, width: int = 96, height: int = 72, kind: str = "PNG") -> bytes:
    """An encoded picture of random blocks."""
    blocks = np.random.default_rng(seed).integers(0, 256, ((height + 7) // 8, (width + 7) // 8, 3), dtype=np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(blocks.repeat(8, 0).repeat(8, 1)[:height, :width]).save(buffer, kind)
    return buffer.getvalue()


def camera_object(count: int = 2, *, width: int = 96, height: int = 72, offset: float = 0.0) -> dict[str, Any]:
    """A cameras.json of views side by side that look ahead, 0.2 apart, of a scene between 1 and 10."""
    views = []
    for index in range(count):
        pose = np.eye(4)
        pose[:3, 3] = [offset + 0.2 * index, offset, offset]
        views.append(
            {"width": width, "height": height, "fx": 80.0, "fy": 80.0, "cx": width / 2, "cy": height / 2}
            | {"c2w": pose.tolist()}
        )
    return {"near": 1.0, "far": 10.0, "views": views}


def post(
    client: TestClient,
    images: list[bytes] | None = None,
    cameras: Any = None,
    *,
    names: list[str] | None = None,
    accept: str | None = None,
    prefer: str | None = None,
    **fields: str,
) -> Any:
    """POST /reconstruct; `cameras` may be an object, or text that is sent as it is."""
    images = [photograph(0), photograph(1)] if images is None else images
    names = names or [f"{index}.png" for index in range(len(images))]
    parts: list[Any] = [("images", (name, data, "image/png")) for name, data in zip(names, images, strict=True)]
    cameras = camera_object(len(images)) if cameras is None else cameras
    text = cameras if isinstance(cameras, str) else json.dumps(cameras)
    if text:
        parts.append(("cameras", ("cameras.json", text.encode(), "application/json")))
    parts += [(name, (None, value)) for name, value in fields.items()]
    headers = {name: value for name, value in (("Accept", accept), ("Prefer", prefer)) if value is not None}
    return client.post("/reconstruct", files=parts, headers=headers)


def stored(settings: Settings) -> dict[str, int]:
    """Every file and folder under the store but its index, with its size: what must not change when a request is
    refused. Inputs of jobs are gone a moment after their end."""
    deadline = time.monotonic() + 120
    while any((settings.store / ".jobs").iterdir()) and time.monotonic() < deadline:
        time.sleep(0.01)
    paths = (path for path in sorted(settings.store.rglob("*")) if not path.name.startswith("index.sqlite"))
    return {str(path.relative_to(settings.store)): path.stat().st_size for path in paths}


def assert_problem(
    answer: Any, status: int, code: str, field: str | None = None, index: int | None = None, *, cured: bool = False
) -> dict:
    """The answer is a problem document with this status, code, field and index, and says something; with `cured` also
    what to do about it."""
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    body = answer.json()
    assert body["status"] == status
    assert body["code"] == code, body
    assert body["type"] == f"urn:gapmes:problem:{code}"
    assert body["title"]
    assert len(body["detail"]) > 5
    if cured:
        assert len(body.get("cure", "")) > 5, body
    if field is not None:
        assert body.get("field") == field, body
    if index is not None:
        assert body.get("index") == index, body
    return body
