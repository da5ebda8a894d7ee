"""The application as a process of `gapmes serve` makes it: settings from the environment, the log set up."""

from __future__ import annotations

from fastapi import FastAPI

from .app import create_app
from .logs import configure
from .settings import Settings


def app() -> FastAPI:
    """What the server is told to load."""
    settings = Settings()
    configure(settings.log)
    return create_app(settings)
