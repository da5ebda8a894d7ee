"""`GET /models`: the networks that a request may name, which are in memory, and the largest `detail`."""

from __future__ import annotations

from fastapi import APIRouter, Response

from .responses import json_response
from .runtime import RuntimeDep
from .schemas import ModelList

router = APIRouter(tags=["operations"])


@router.head("/models", include_in_schema=False)
@router.get("/models", response_model=ModelList)
def list_models(runtime: RuntimeDep) -> Response:
    """The configured models, default first; `loaded` is the state of the process that answers."""
    document = runtime.models.document() | {"max_detail": runtime.settings.max_detail}
    return json_response(document, headers={"Cache-Control": "no-store"})
