"""`Repr-Digest` headers (RFC 9530): the SHA-256 of a file of Gaussians, by which a client can check what has
arrived, and compare scenes."""

from __future__ import annotations

import base64
import hashlib
from functools import lru_cache
from pathlib import Path

REPR_DIGEST = "Repr-Digest"


def repr_digest(data: bytes) -> str:
    """The header's value for these bytes."""
    return _value(hashlib.sha256(data).digest())


@lru_cache(maxsize=1024)
def repr_digest_of(path: Path, etag: str) -> str:
    """The header's value for a stored file, which is read once for each entity tag: many answers have parts of it."""
    with path.open("rb") as file:
        return _value(hashlib.file_digest(file, "sha256").digest())


def _value(digest: bytes) -> str:
    """A dictionary of byte sequences (RFC 8941 sections 3.2 and 3.3.5)."""
    return f"sha-256=:{base64.b64encode(digest).decode()}:"
