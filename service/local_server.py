"""A service of one's own on loopback: started as a subprocess, waited for, and stopped whatever happens."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import httpx

from .errors import GapmesError, ModelError
from .process.disk import full_is_refused
from .progress import Stages

READY_TIMEOUT_S = 300.0  # the first start compiles every kernel, which a slow core needs a minute or two for
POLL_S = 0.2
STOP_TIMEOUT_S = 10.0
ROOM = 1 << 16  # bytes, without which the service could not say what is wrong
KEYS = ("GAPMES_API_KEY", "GAPMES_API_KEY_FILE")
LOADING = ("start", "import", "model", "kernels")  # the stages that /readyz names, in order


@contextmanager
def local_server(log: Path, *, store: Path, keep: bool, port: int = 0) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Yield (address, process) of `gapmes serve` on `port` if that is free, else on a free one; stopped at the end
    unless `keep` and no failure, without `keep` also if this process is killed. It needs no key, whatever the
    environment says."""
    port = _free_port(port)
    command = [sys.executable, "-m", "gapmes.service.cli", "serve", "--host", "127.0.0.1", "--port", str(port)]
    command += [] if keep else ["--parent", str(os.getpid())]
    with log.open("wb") as output:
        process = subprocess.Popen(
            [*command, "--store", str(store)],
            stdout=output,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            env={name: value for name, value in os.environ.items() if name not in KEYS} | {"PYTHONUNBUFFERED": "1"},
            start_new_session=True,  # Ctrl-C reaches this process alone, which then stops the server in order
        )
    done = False
    try:
        yield f"http://127.0.0.1:{port}", process
        done = True
    finally:
        if not (keep and done):
            process.terminate()
            try:
                process.wait(STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def local_client(address: str, timeout_s: float) -> httpx.Client:
    """A client of a service on loopback, which no proxy of the environment stands before."""
    return httpx.Client(base_url=address, timeout=timeout_s, trust_env=False)


def wait_until_ready(
    client: httpx.Client, process: subprocess.Popen[bytes], log: Path, stages: Stages
) -> dict[str, Any]:
    """Poll /readyz and return what it says; raises `ModelError` when the service fails, `StorageFull` or
    `GapmesError` when it ends or takes too long."""
    deadline = time.monotonic() + READY_TIMEOUT_S
    with stages.stage("start service", len(LOADING)) as step:
        while time.monotonic() < deadline:
            if process.poll() is not None:
                raise _ended(process.returncode, log)
            try:
                answer = client.get("/readyz")
            except httpx.TransportError:
                time.sleep(POLL_S)
                continue
            body = answer.json()
            if answer.status_code == 200:
                return body
            if body.get("state") == "failed":
                raise ModelError(body["detail"], cure=f"see {log}")
            step(LOADING.index(body["stage"]) if body.get("stage") in LOADING else 0)
            time.sleep(POLL_S)
    raise GapmesError(f"the service is not ready after {READY_TIMEOUT_S:.0f} s", cure=f"see {log}")


def checked(answer: httpx.Response) -> httpx.Response:
    """The answer, or its problem document raised as the error that it is of."""
    if answer.is_success:
        return answer
    problem = answer.json()
    asked = f"{answer.request.method} {answer.request.url.path}"
    raise _kind(problem["code"])(
        f"{asked} -> {answer.status_code} {problem['code']}: {problem['detail']}",
        field=problem.get("field"),
        index=problem.get("index"),
        cure=problem.get("cure"),
    )


def _ended(code: int, log: Path) -> GapmesError:
    """What the service said last. Raises `StorageFull` where it could not say a thing because the disk is full."""
    said = [line for line in log.read_text(encoding="utf-8", errors="replace").split("\n") if line.strip()]
    if not said:
        with full_is_refused(f"what the service writes into {log.parent}"), TemporaryFile(dir=log.parent) as probe:
            probe.write(bytes(ROOM))
            probe.flush()
    last = f": {said[-1].strip().removeprefix('error: ')}" if said else ""
    return GapmesError(f"the service ended with code {code}{last}", cure=f"see {log}")


def _kind(code: str) -> type[GapmesError]:
    """The class of this code, `GapmesError` where there is none."""
    kinds = [GapmesError]
    for kind in kinds:
        kinds += kind.__subclasses__()
    return next((kind for kind in kinds if kind.code == code), GapmesError)


def _free_port(wanted: int) -> int:
    for port in (wanted, 0):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as the server does: a port just left is free
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return probe.getsockname()[1]
    raise GapmesError("no port of 127.0.0.1 is free", field="port")
