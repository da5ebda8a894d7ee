"""`gapmes serve` on a free loopback port with a store of its own, and the memory of its processes."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx


@dataclass
class Service:
    """A running service."""

    address: str
    process: subprocess.Popen[bytes]
    store: Path

    def workers(self) -> list[int]:
        """The processes that answer requests: the service's own, or its children."""
        children = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()
        found = [int(pid) for pid in children if b"spawn_main" in _read(f"/proc/{pid}/cmdline")]
        return found or [self.process.pid]

    def memory_mb(self) -> tuple[float, float, float]:
        """Sums over all workers: resident memory, private memory, and memory with shared pages counted once."""
        sums = {"Rss": 0.0, "Private_Dirty": 0.0, "Pss": 0.0}
        for pid in self.workers():
            for line in _read(f"/proc/{pid}/smaps_rollup").decode().splitlines():
                name, _, rest = line.partition(":")
                if name in sums:
                    sums[name] += float(rest.split()[0]) / 1024
        return sums["Rss"], sums["Private_Dirty"], sums["Pss"]

    def peak_mb(self) -> float:
        """The sum of each worker's peak resident memory so far."""
        lines = (line for pid in self.workers() for line in _read(f"/proc/{pid}/status").decode().splitlines())
        return sum(float(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM"))


def _read(path: str) -> bytes:
    try:
        return Path(path).read_bytes()
    except OSError:  # the process ended meanwhile
        return b""


@contextmanager
def running(folder: Path, options: Sequence[str] = (), seconds: float = 300.0) -> Iterator[Service]:
    """Start it, wait until it is ready, and end it in any case."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    store = folder / "scenes"
    command = [
        sys.executable,
        "-m",
        "gapmes.service.cli",
        "serve",
        "--port",
        str(port),
        "--store",
        str(store),
        *options,
    ]
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log, env=os.environ | {"GAPMES_LOG": "json"})
    service = Service(f"http://127.0.0.1:{port}", process, store)
    try:
        deadline = time.monotonic() + seconds
        while not ready(service.address):
            if process.poll() is not None or time.monotonic() > deadline:
                raise SystemExit((folder / "log").read_text()[-2000:])
            time.sleep(0.2)
        yield service
    finally:
        process.terminate()
        try:
            process.wait(60)
        except subprocess.TimeoutExpired:
            process.kill()


def ready(address: str) -> bool:
    """Whether /readyz says that the service is ready."""
    try:
        return httpx.get(f"{address}/readyz", timeout=5).status_code == 200
    except httpx.TransportError:
        return False
