"""Requests that load a file of Gaussians."""

from __future__ import annotations

import json
from typing import Any

from format_cases import moderate
from starlette.testclient import TestClient

from gapmes.service.formats.registry import FORMATS

RAW = {"Content-Type": "application/octet-stream"}


def file_of(name: str, seed: int = 0) -> bytes:
    return FORMATS[name].write(moderate(300, seed, 1)).data


def load_raw(client: TestClient, data: bytes, **query: str) -> Any:
    return client.post("/scenes", params=query, content=data, headers=RAW)


def load_form(client: TestClient, data: bytes, name: str = "scene.ply", cameras: Any = None, **fields: str) -> Any:
    parts: list[Any] = [("file", (name, data, "application/octet-stream"))]
    if cameras is not None:
        parts.append(("cameras", (None, json.dumps(cameras))))
    return client.post("/scenes", files=[*parts, *((key, (None, value)) for key, value in fields.items())])
