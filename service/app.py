"""The HTTP application: `create_app(settings)` puts routes, errors and limits together; nothing is loaded at import."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.metadata import version

from fastapi import FastAPI

from .http import health, page, problems, reconstruct, render, scenes
from .http.limits import BodyLimit
from .http.runtime import Runtime
from .settings import Settings


def create_app(settings: Settings | None = None) -> FastAPI:
    """Build the application; the model is loaded and the kernels warmed when the server starts it, see /readyz."""
    settings = settings or Settings()
    runtime = Runtime(settings)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        async with runtime.running():
            yield

    app = FastAPI(
        title="gapmes",
        description="Posed photographs in, 3D Gaussians and novel views out.",
        version=version("gapmes"),
        lifespan=lifespan,
        docs_url=None,  # the stock pages load scripts from other hosts; /openapi.json has the same content
        redoc_url=None,
    )
    app.state.runtime = runtime
    problems.install(app)
    for module in (health, page, reconstruct, render, scenes):
        app.include_router(module.router)
    app.add_middleware(BodyLimit, max_bytes=settings.max_upload_bytes)
    return app
