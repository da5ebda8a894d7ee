"""Ids of scenes: a hash of everything that a scene is made from."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import Any


def scene_id(model_sha256: str, images: Sequence[bytes], cameras_json: object, options: Mapping[str, Any]) -> str:
    """The first 32 hex digits of the SHA-256 over all inputs, each prefixed by its length. The order of keys does not
    matter, and 512 equals 512.0."""
    digest = hashlib.sha256()
    parts = [model_sha256.encode(), _canonical(cameras_json), _canonical(options), *images]
    for part in parts:
        digest.update(len(part).to_bytes(8, "big"))
        digest.update(part)
    return digest.hexdigest()[:32]


def _canonical(value: object) -> bytes:
    return json.dumps(_plain(value), sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def _plain(value: object) -> object:
    """Tuples as lists, integers as floats: values that are equal in JSON give equal ids."""
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) <= 2**53:
        return float(value)
    return value
