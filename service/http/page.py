"""The web page and its files from the package, with content security policies that allow no other host."""

from __future__ import annotations

import gzip
import hashlib
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

from fastapi import APIRouter, Request, Response
from starlette.exceptions import HTTPException

from ..shipped import sample_folder
from .files import matches, not_modified
from .responses import takes_gzip

router = APIRouter(include_in_schema=False)

STATIC = Path(__file__).parents[1] / "static"
SWAGGER = ("swagger-ui-bundle.js", "swagger-ui.css")  # of the package fastapi-offline
VIEWER = "viewer/index.js"  # exists if npm was available when the package was built
MEDIA_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
    ".json": "application/json",
    ".png": "image/png",
}
PACKED = (".html", ".css", ".js", ".svg", ".json")  # worth compressing

# No inline scripts or styles, no other host; images also from blobs, as the page fetches renders.
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; media-src 'self' blob:; "
    "connect-src 'self'; frame-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
# The viewer compiles WebAssembly, sorts in a worker from a blob, and embeds icons and fonts in its style.
VIEWER_POLICY = (
    "default-src 'none'; script-src 'self' 'wasm-unsafe-eval' blob:; worker-src 'self' blob:; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; "
    "connect-src 'self' data: blob:; form-action 'none'; base-uri 'none'; frame-ancestors 'self'"
)
# Swagger UI sets styles of elements, and embeds icons in its style.
DOCS_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
    "connect-src 'self'; form-action 'none'; base-uri 'none'; frame-ancestors 'none'"
)
HEADERS = {"X-Content-Type-Options": "nosniff", "Referrer-Policy": "same-origin", "Cache-Control": "no-cache"}


class _File(NamedTuple):
    body: bytes
    packed: bytes | None
    etag: str
    media_type: str


@router.head("/")
@router.get("/")
def index(request: Request) -> Response:
    return _answer(request, "index.html", POLICY)


@router.head("/viewer")
@router.get("/viewer")
def viewer(request: Request) -> Response:
    """The frame with the WebGL viewer; 404 if the package was built without it."""
    if VIEWER not in _files():
        raise HTTPException(404)
    return _answer(request, "viewer.html", VIEWER_POLICY)


@router.head("/docs")
@router.get("/docs")
def docs(request: Request) -> Response:
    """Swagger UI over /openapi.json, as FastAPI's own page is, which loads its scripts from another host."""
    return _answer(request, "docs.html", DOCS_POLICY)


@router.head("/static/{name:path}")
@router.get("/static/{name:path}")
def static(request: Request, name: str) -> Response:
    """A file of the page or of the sample scene; looked up in a table, never joined to a path."""
    if name not in _files():
        raise HTTPException(404)
    return _answer(request, name, POLICY)


def _answer(request: Request, name: str, policy: str) -> Response:
    file = _loaded(_files()[name])
    headers = HEADERS | {"Content-Security-Policy": policy, "ETag": file.etag}
    if file.packed is not None:
        headers["Vary"] = "Accept-Encoding"
    if matches(request, file.etag):
        return not_modified(headers)
    body = file.body
    if file.packed is not None and takes_gzip(",".join(request.headers.getlist("accept-encoding"))):
        body = file.packed
        headers["Content-Encoding"] = "gzip"
    return Response(body, media_type=file.media_type, headers=headers)


@cache
def _files() -> dict[str, Path]:
    """Files by their name in the URL."""
    found = {}
    for root, prefix in ((STATIC, ""), (sample_folder(), "sample/")):
        for path in root.rglob("*"):
            if path.suffix in MEDIA_TYPES and path.is_file():
                found[prefix + path.relative_to(root).as_posix()] = path
    swagger = Path(str(files("fastapi_offline"))) / "static"
    return found | {f"docs/{name}": swagger / name for name in SWAGGER}


@cache
def _loaded(path: Path) -> _File:
    body = path.read_bytes()
    packed = gzip.compress(body, 6, mtime=0) if path.suffix in PACKED else None
    etag = f'W/"{hashlib.sha256(body).hexdigest()[:32]}"'  # weak: one tag for both encodings
    return _File(body, packed, etag, MEDIA_TYPES[path.suffix])
