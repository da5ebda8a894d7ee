"""Health probes: /healthz for a live event loop, /readyz for models and kernels loaded in all processes."""

from __future__ import annotations

from typing import Any

import anyio.to_thread
from fastapi import APIRouter, Response

from ..errors import ModelNotReady, StorageFull
from .responses import json_response
from .runtime import RuntimeDep
from .schemas import Alive, Ready

router = APIRouter(tags=["operations"])


@router.head("/healthz", include_in_schema=False)
@router.get("/healthz", response_model=Alive)
async def healthz() -> dict[str, str]:
    """200 as long as the event loop answers."""
    return {"status": "ok"}


@router.head("/readyz", include_in_schema=False)
@router.get("/readyz", response_model=Ready)
async def readyz(runtime: RuntimeDep) -> Response:
    """200 with the loaded models and the time of each stage; 503 until all processes are loaded, with the current or
    the failed stage, and while another program keeps the store's index locked; 507 while the store cannot be
    written."""
    stage = runtime.stage  # read first: if it became "ready" meanwhile, the answer would blame the other processes
    try:
        models: dict[str, Any] = runtime.models.document()
        if not runtime.peers.complete:
            raise ModelNotReady(
                f"{len(runtime.peers.living())} of {runtime.peers.count} processes are loaded", cure="poll and retry"
            )
    except ModelNotReady as error:
        state = "starting" if runtime.failure is None else "failed"
        error.extra |= {"state": state, "stage": stage, "timings": runtime.timings}
        raise
    if not await anyio.to_thread.run_sync(runtime.store.writable, limiter=runtime.probes):
        cure = "is its disk full or read-only, or index.sqlite damaged?"
        raise StorageFull("the store cannot be written", field="store", cure=cure)
    default, *_ = models["models"]
    loaded = {model["name"]: model["loaded"] for model in models["models"]}
    return json_response({"status": "ready", "model": default, "loaded": loaded, "timings": runtime.timings})
