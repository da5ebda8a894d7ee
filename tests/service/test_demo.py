"""The demonstration from end to end over a stand-in model; the service it starts never outlives it unasked."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import httpx
import numpy as np
import onnx
import pytest
from PIL import Image
from standin_model import write_standin

from gapmes.service import read_ply

COMMAND = [sys.executable, "-m", "gapmes.service.cli", "demo"]


@pytest.fixture
def environment(standin_model: Path) -> dict[str, str]:
    return os.environ | {"GAPMES_MODEL": str(standin_model), "GAPMES_THREADS": "1", "KEEP": ""}


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def wait_for(condition: object, seconds: float = 120) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_demo_leaves_its_files_and_stops_its_service(tmp_path: Path, environment: dict[str, str]) -> None:
    done = subprocess.run([*COMMAND, "-o", tmp_path, "--json"], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    pictures = [f"view_{number}.png" for number in range(4)]
    expected = ["comparison.png", "scene.ply", "server.log", *pictures]
    assert sorted(path.name for path in tmp_path.iterdir()) == expected
    assert len(result["psnr_db"]) == 4
    assert all(np.isfinite(result["psnr_db"]))
    assert len(read_ply(tmp_path / "scene.ply")) > 0
    for name in pictures:
        assert np.asarray(Image.open(tmp_path / name)).std() > 5, "an empty picture"
    assert result["address"] in done.stderr
    for stage in ("start service", "reconstruct", "network", "render views", "compare"):
        assert stage in done.stderr
    with pytest.raises(httpx.ConnectError):
        httpx.get(result["address"] + "/healthz")


def test_keep_leaves_the_service_on_the_port_of_the_settings(tmp_path: Path, environment: dict[str, str]) -> None:
    """On a machine with a proxy and a key in its environment, neither of which is the demonstration's."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    machine = {"HTTP_PROXY": "http://127.0.0.1:9", "http_proxy": "http://127.0.0.1:9", "NO_PROXY": "", "no_proxy": ""}
    given = environment | {"KEEP": "1", "GAPMES_PORT": str(port), "GAPMES_API_KEY": "secret"} | machine
    done = subprocess.run([*COMMAND, "-o", tmp_path, "--json"], env=given, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["address"] == f"http://127.0.0.1:{port}"
    try:
        scenes = httpx.get(result["address"] + "/scenes").json()["scenes"]
        assert [scene["id"] for scene in scenes] == [result["scene"]]
    finally:
        os.kill(result["pid"], signal.SIGTERM)


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM])
def test_interruption_stops_the_service(tmp_path: Path, environment: dict[str, str], ending: signal.Signals) -> None:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a background ignores it, and so would we
    with subprocess.Popen([*COMMAND, "-o", tmp_path, "--keep"], env=environment, stderr=subprocess.PIPE) as demo:
        signal.signal(signal.SIGINT, before)
        log = tmp_path / "server.log"
        wait_for(lambda: log.exists() and b"Started server process" in log.read_bytes())
        server = int(log.read_text().split("Started server process [")[1].split("]")[0])
        demo.send_signal(ending)
        assert demo.wait(120) != 0
    wait_for(lambda: not alive(server))


def test_failure_is_one_line_and_stops_the_service(tmp_path: Path, environment: dict[str, str]) -> None:
    """The file is a model of ours by all that it says, so that the service starts; the runtime cannot load it."""
    model = write_standin(tmp_path / "model.onnx")
    broken = onnx.load(model)
    broken.graph.node[0].op_type = "Nonsense"
    onnx.save(broken, model)
    done = subprocess.run(
        [*COMMAND, "-o", tmp_path], env=environment | {"GAPMES_MODEL": str(model)}, capture_output=True, text=True
    )
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    lines = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert len(lines) == 1
    assert "stage 'model'" in lines[0]
    assert str(tmp_path / "server.log") in lines[0]
    log = (tmp_path / "server.log").read_text()
    assert str(model) in log
    server = int(log.split("Started server process [")[1].split("]")[0])
    assert not alive(server)
