"""The web page: three static files of the package, served under a policy that allows nothing from elsewhere."""

from __future__ import annotations

from importlib.resources import files

from fastapi import APIRouter, Response
from starlette.exceptions import HTTPException

router = APIRouter(include_in_schema=False)

MEDIA_TYPES = {
    "index.html": "text/html; charset=utf-8",
    "page.css": "text/css; charset=utf-8",
    "page.js": "text/javascript; charset=utf-8",
}

# No inline script or style, no other host, no framing; pictures also from blobs, which is how the page shows renders.
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; "
        "form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",
}


@router.get("/")
def index() -> Response:
    return _file("index.html")


@router.get("/static/{name}")
def static(name: str) -> Response:
    """One of the page's own files; the name is looked up in a table and never joined to a path otherwise."""
    if name not in MEDIA_TYPES:
        raise HTTPException(404)
    return _file(name)


def _file(name: str) -> Response:
    body = files(__package__).joinpath("..", "static", name).read_bytes()
    return Response(body, media_type=MEDIA_TYPES[name], headers=HEADERS)
