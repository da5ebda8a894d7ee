"""The HTTP application: `create_app(settings)` puts routes, errors and limits together; nothing is loaded at import."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AbstractContextManager, asynccontextmanager, nullcontext
from importlib.metadata import version
from typing import Any

from fastapi import Depends, FastAPI
from fastapi.openapi.utils import get_openapi
from starlette.middleware.cors import CORSMiddleware

from .addresses import listed
from .http import (
    check,
    health,
    jobs,
    load,
    metrics,
    models,
    page,
    preview,
    problems,
    reconstruct,
    render,
    scenes,
    viewer,
)
from .http.access import OPEN, SCHEMES, KeyNeeded
from .http.described import describe
from .http.heads import Heads
from .http.hosts import KnownHosts
from .http.limits import BodyLimit
from .http.observe import Observed
from .http.origins import KnownPages
from .http.parameters import given_once
from .http.runtime import Runtime
from .http.schemas import Problem
from .http.shutdown_deadline import AnsweredInTime
from .http.unread import BodyLeft
from .progress import Listener
from .settings import Settings

# What scripts of other origins may read of an answer, where they may call at all.
EXPOSED = ["ETag", "Location", "Retry-After", "Server-Timing", "X-Request-ID"]
EXPOSED += ["Accept-Ranges", "Content-Disposition", "Content-Range", "Preference-Applied", "Repr-Digest"]
EXPOSED += [f"X-Gapmes-{name}" for name in ("Scene", "Stats", "Notes", "Problem")]
EXPOSED += [f"X-Gapmes-Depth-{name}" for name in ("Min", "Max", "Scale", "Offset")]


# In the order in which they are shown.
TAGS = [
    {"name": "reconstruction", "description": "Scenes from photographs"},
    {"name": "views", "description": "Pictures and films of a scene"},
    {"name": "scenes", "description": "Stored scenes and their files"},
    {"name": "jobs", "description": "Reconstructions that are waiting or running"},
    {"name": "operations", "description": "State of the service"},
]


def create_app(
    settings: Settings | None = None,
    bars: AbstractContextManager[Listener] | None = None,
    held: AbstractContextManager[object] | None = None,
) -> FastAPI:
    """Build the application; the model is loaded and the kernels warmed when the server starts it, see /readyz.

    `bars` is entered for as long as that takes, and told about it; `held` is left when the last request has ended.
    """
    settings = settings or Settings()
    runtime = Runtime(settings, bars)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        with held or nullcontext():
            async with runtime.running():
                yield

    app = FastAPI(
        title="gapmes",
        description="Posed photographs in, 3D Gaussians and novel views out.",
        version=version("gapmes"),
        lifespan=lifespan,
        docs_url=None,  # the stock pages load scripts from other hosts: `page.py` has one that does not
        redoc_url=None,
        redirect_slashes=False,  # to an address that the request's Host would choose
        responses=problems.RESPONSES,
    )
    app.state.runtime = runtime
    key = settings.key()
    app.openapi = lambda: _schema(app, locked=key is not None)  # type: ignore[method-assign]
    problems.install(app)
    for module in (
        health, metrics, models, page, check, reconstruct, jobs, render, viewer, preview, load, scenes,
    ):  # fmt: skip
        app.include_router(module.router, dependencies=[Depends(given_once)])
    app.add_middleware(BodyLimit, max_bytes=settings.max_upload_bytes, most_together=settings.max_uploads_bytes)
    if key is not None:
        app.add_middleware(KeyNeeded, key=key)
    origins, hosts = listed(settings.cors_origins), listed(settings.allowed_hosts)
    app.add_middleware(KnownPages, origins=origins)
    app.add_middleware(problems.FaultsAnswered)
    if origins:  # asked before the key: a browser's question brings none
        app.add_middleware(
            CORSMiddleware, allow_origins=origins, allow_methods=["*"], allow_headers=["*"], expose_headers=EXPOSED
        )
    if hosts:
        app.add_middleware(KnownHosts, hosts=hosts)
    app.add_middleware(Heads)
    app.add_middleware(AnsweredInTime, shutdown_deadline=runtime.shutdown_deadline, seconds=settings.drain_seconds)
    app.add_middleware(Observed)
    app.add_middleware(BodyLeft, shutdown_deadline=runtime.shutdown_deadline)
    return app


def _schema(app: FastAPI, *, locked: bool) -> dict[str, Any]:
    """The open API, with the one form that all errors have, and the key that a `locked` service asks for."""
    if app.openapi_schema is None:
        schema = get_openapi(
            title=app.title, version=app.version, description=app.description, tags=TAGS, routes=app.routes
        )
        describe(schema["paths"])
        problem = Problem.model_json_schema(ref_template="#/components/schemas/{model}")
        schema.setdefault("components", {}).setdefault("schemas", {})["Problem"] = problem
        if locked:
            schema["components"]["securitySchemes"] = SCHEMES
            schema["security"] = [{name: []} for name in SCHEMES]  # any one of them
            for path in OPEN:
                for operation in schema["paths"].get(path, {}).values():
                    operation["security"] = []
        app.openapi_schema = schema
    return app.openapi_schema
