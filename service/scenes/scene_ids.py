"""A scene's id: what it was made from, and nothing else."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import Any


def scene_id(model_sha256: str, images: Sequence[bytes], cameras_json: object, options: Mapping[str, Any]) -> str:
    """32 hex characters of the sha256 over all inputs, each with its length in front, so that none can run into
    the next. Equal JSON gives equal ids whatever the order of keys, and 512 is 512.0."""
    digest = hashlib.sha256()
    parts = [model_sha256.encode(), _canonical(cameras_json), _canonical(options), *images]
    for part in parts:
        digest.update(len(part).to_bytes(8, "big"))
        digest.update(part)
    return digest.hexdigest()[:32]


def _canonical(value: object) -> bytes:
    return json.dumps(_plain(value), sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def _plain(value: object) -> object:
    """Tuples as lists, whole numbers as floats: what JSON cannot tell apart must not tell ids apart."""
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) <= 2**53:
        return float(value)
    return value
