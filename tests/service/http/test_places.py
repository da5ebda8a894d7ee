"""Current counts: how many requests hold places, in this process and in all live ones."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from starlette.testclient import TestClient

TAKES = """
import asyncio, sys
from gapmes.service.http.concurrency import ConcurrencyLimit
async def main():
    pictures, uploads = ConcurrencyLimit("pictures", 9, "drawing"), ConcurrencyLimit("uploads", 9, "sending")
    async with pictures.slot(), pictures.slot(), uploads.slot():
        async with pictures.slot():
            pass
        print("taken", flush=True)
        sys.stdin.read()
asyncio.run(main())
"""
SUMS = """
import os
from pathlib import Path
from prometheus_client import CollectorRegistry
from prometheus_client.multiprocess import MultiProcessCollector
from gapmes.service.metrics import forget_dead
from gapmes.service.process.peers import FOLDER
forget_dead(Path(os.environ[FOLDER]))
registry = CollectorRegistry()
MultiProcessCollector(registry)
print(*(registry.get_sample_value("gapmes_places_taken", {"of": of}) for of in ("pictures", "uploads")))
"""


KINDS = ("pictures", "files", "looks", "uploads", "streams", "scenes")


def test_places_of_every_kind_are_shown(client: TestClient) -> None:
    def taken() -> list[float]:
        lines = dict(line.rpartition(" ")[::2] for line in client.get("/metrics").text.splitlines())
        return [float(lines[f'gapmes_places_taken{{of="{kind}"}}']) for kind in KINDS]

    runtime, held = client.app.state.runtime, client.portal.wrap_async_context_manager
    assert taken() == [0] * 6
    with held(runtime.streams.slot()), held(runtime.pictures.limit.slot()), held(runtime.pictures.limit.slot()):
        assert taken() == [2, 0, 0, 0, 1, 0]
    assert taken() == [0] * 6


def test_places_are_summed_over_the_processes_that_live(tmp_path: Path) -> None:
    """A killed process returns no place, and holds none."""
    environment = os.environ | {"PROMETHEUS_MULTIPROC_DIR": str(tmp_path)}
    words = [sys.executable, "-c", TAKES]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "env": environment, "text": True}
    with subprocess.Popen(words, **pipes) as one, subprocess.Popen(words, **pipes) as two:
        try:
            assert [process.stdout.readline() for process in (one, two)] == ["taken\n", "taken\n"]
            assert summed(environment) == "4.0 2.0\n"
            two.kill()
            two.wait()
            assert summed(environment) == "2.0 1.0\n"
        finally:
            one.kill()
            two.kill()


def summed(environment: dict[str, str]) -> str:
    """Of pictures and uploads, as /metrics of several workers has them."""
    return subprocess.run([sys.executable, "-c", SUMS], env=environment, capture_output=True, text=True).stdout
