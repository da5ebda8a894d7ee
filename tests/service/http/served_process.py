"""`gapmes serve` in a process of its own, with a client that waits until it is ready."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx


@contextmanager
def own_port() -> Iterator[int]:
    """A port for a service to listen on, which meanwhile is given to no other process that asks for a free one."""
    with socket.socket() as bound:
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as the server does, which may bind it too then
        bound.bind(("127.0.0.1", 0))
        yield bound.getsockname()[1]


@contextmanager
def serving(
    store: Path, model: Path, log: Path, *more: str, shell: str = "", **environment: str
) -> Iterator[tuple[httpx.Client, Any]]:
    """`shell`: redirections of the streams, such as `>&-`."""
    with own_port() as port:
        gapmes = [sys.executable, "-m", "gapmes.service.cli", "serve", "--port", str(port), "--threads", "1", *more]
        command = ["sh", "-c", f'exec "$0" "$@" {shell}', *gapmes]
        with log.open("wb") as output:
            process = subprocess.Popen(
                [*command, "--store", str(store), "--model", str(model)],
                stdout=output,
                stderr=output,
                env=os.environ | environment,
            )
        try:
            with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=120) as client:
                until(lambda: answers(client), 300)
                yield client, process
        finally:
            process.terminate()  # with its workers, and what they share
            try:
                process.wait(120)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def answers(client: httpx.Client) -> bool:
    try:
        return client.get("/readyz").status_code == 200
    except httpx.TransportError:
        return False


def until(reached: Any, seconds: float = 120.0, pause: float = 0.05) -> None:
    deadline = time.monotonic() + seconds
    while not reached():
        assert time.monotonic() < deadline
        time.sleep(pause)
