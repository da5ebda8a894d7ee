"""The application as a process of `gapmes serve` makes it: settings from the environment, memory that goes back to the
system, the log set up, bars where somebody looks."""

from __future__ import annotations

import sys

from fastapi import FastAPI

from .allocator import give_back_freed
from .app import create_app
from .logs import configure
from .settings import Settings
from .terminal import ProgressBars


def app() -> FastAPI:
    """What the server is told to load."""
    give_back_freed()
    settings = Settings()
    configure(settings.log, quiet=settings.quiet)
    shown = sys.stderr.isatty() and settings.workers == 1 and settings.log == "text" and not settings.quiet
    return create_app(settings, ProgressBars() if shown else None)
