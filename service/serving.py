"""The application in a process of `gapmes serve`: settings from the environment, log, progress bars on a terminal, and
an end when the process that started it has ended."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from contextlib import ExitStack, suppress
from pathlib import Path

from fastapi import FastAPI

from .app import create_app
from .process.allocator import give_back_freed
from .process.logs import configure
from .process.own_folder import drop_unused, in_use
from .process.peers import FOLDER, OURS
from .process.streams import open_missing
from .process.temporary_folder import use_temporary_folder
from .process.terminal import ProgressBars
from .settings import Settings


def app() -> FastAPI:
    """What the server is told to load."""
    open_missing()
    shared = _what_workers_share()
    _end_with_the_watcher()
    give_back_freed()
    use_temporary_folder()
    settings = Settings()
    configure(settings.log, quiet=settings.quiet)
    shown = sys.stderr.isatty() and settings.workers == 1 and settings.log == "text" and not settings.quiet
    return create_app(settings, ProgressBars() if shown else None, shared)


def _end_with_the_watcher() -> None:
    """One of several workers ends in order when the process that started it is gone, killed perhaps: otherwise it would
    hold the port, and nobody would replace it."""
    watcher = multiprocessing.parent_process()
    if watcher is None:
        return

    def wait() -> None:
        watcher.join()
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=wait, name="watcher", daemon=True).start()


def _what_workers_share() -> ExitStack:
    """The folder of their numbers is in use until this is left; the last who leaves it removes it, where the process
    that watches them cannot: what they still answer is counted there."""
    held = ExitStack()
    folder = Path(os.environ.get(FOLDER, ""))
    if folder.name.startswith(OURS):
        held.callback(drop_unused, folder)
        with suppress(OSError):  # somebody has removed it, and where it was
            folder.mkdir(mode=0o700, exist_ok=True)
            held.enter_context(in_use(folder))
    return held
