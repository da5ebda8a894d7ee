"""Workers whose supervisor was killed: their shared state stays as long as one of them answers."""

from __future__ import annotations

import os
import socket
from pathlib import Path

from served_process import serving, until

from gapmes.service.process.peers import FOLDER

HALF = b"POST /scenes HTTP/1.1\r\nHost: a\r\nContent-Type: application/octet-stream\r\nContent-Length: 8\r\n\r\nhalf"


def test_an_upload_that_was_begun_is_counted_and_answered(tmp_path: Path, standin_model: Path) -> None:
    log = tmp_path / "log"
    with serving(tmp_path / "scenes", standin_model, log, "--workers", "2") as (client, process):
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        told = b"\0".join(Path(f"/proc/{pid}/environ").read_bytes() for pid in children).split(b"\0")
        [shared] = {Path(os.fsdecode(line.partition(b"=")[2])) for line in told if line.startswith(FOLDER.encode())}
        assert shared.is_dir()
        with socket.create_connection((client.base_url.host, client.base_url.port), timeout=60) as upload:
            upload.sendall(HALF)
            until(lambda: b'gapmes_places_taken{of="uploads"} 1.0' in client.get("/metrics").content)
            process.kill()
            process.wait()
            until(lambda: "Waiting for connections to close" in log.read_text())
            assert shared.is_dir()
            upload.sendall(b"half")
            assert upload.recv(12) == b"HTTP/1.1 422"
        until(lambda: not shared.exists())
    assert "Traceback" not in log.read_text()
