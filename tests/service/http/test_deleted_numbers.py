"""The folder that several workers share in memory is deleted, as systems do when a user logs out."""

from __future__ import annotations

import os
import shutil
import signal
from pathlib import Path

import httpx
from served_process import answers, serving, until
from test_serve import loaded_file, workers


def test_a_worker_is_replaced_where_what_they_share_was_deleted(tmp_path: Path, standin_model: Path) -> None:
    with serving(tmp_path / "scenes", standin_model, tmp_path / "log", "--workers", "2") as (client, process):
        first = workers(process)
        shutil.rmtree(loaded_file(first[0]).parent)
        assert client.get("/metrics").status_code == 200
        until(lambda: all(loaded_file(worker).exists() for worker in first))  # they announce themselves again
        os.kill(first[0], signal.SIGKILL)

        def replaced() -> bool:
            found = workers(process)
            return len(found) == 2 and first[0] not in found and all(loaded_file(pid).exists() for pid in found)

        until(replaced, 300)
        until(lambda: answers(client), 300)
        for _ in range(10):  # each may meet another worker
            assert httpx.get(f"{client.base_url}/readyz", timeout=120).status_code == 200
            assert httpx.get(f"{client.base_url}/metrics", timeout=120).status_code == 200
        process.send_signal(signal.SIGTERM)
        assert process.wait(120) == 0
