"""`GET /models`: which networks a request may name, what they are, which are in memory, and the most detail."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Response

from .responses import json_response
from .runtime import Runtime, runtime_of
from .schemas import ModelList

router = APIRouter(tags=["operations"])


@router.head("/models", include_in_schema=False)
@router.get("/models", response_model=ModelList)
def list_models(runtime: Annotated[Runtime, Depends(runtime_of)]) -> Response:
    """The configured models, the default one first; `loaded` is that of the process that answers."""
    document = runtime.models.document() | {"max_detail": runtime.settings.max_detail}
    return json_response(document, headers={"Cache-Control": "no-store"})
