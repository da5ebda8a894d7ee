"""The demonstration end to end with a stand-in model; its service never outlives it unless asked to."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import numpy as np
import onnx
import pytest
from cli_runs import assert_refusal, run
from living import alive, wait_for
from PIL import Image
from served_process import own_port
from standin_model import write_standin

from gapmes.service import read_ply

COMMAND = [sys.executable, "-m", "gapmes.service.cli", "demo"]


@pytest.fixture
def environment(standin_model: Path) -> dict[str, str]:
    return os.environ | {"GAPMES_MODEL": str(standin_model), "GAPMES_THREADS": "1", "KEEP": ""}


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
    with own_port() as port:
        machine = {
            "HTTP_PROXY": "http://127.0.0.1:9",
            "http_proxy": "http://127.0.0.1:9",
            "NO_PROXY": "",
            "no_proxy": "",
        }
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


@contextmanager
def started(folder: Path, environment: dict[str, str], *more: str) -> Iterator[tuple[subprocess.Popen[bytes], int]]:
    """The demonstration and the number of its service. It is not in the background, nor under nohup."""
    heard = {signal.SIGINT: signal.default_int_handler, signal.SIGHUP: signal.SIG_DFL}
    before = {number: signal.signal(number, handler) for number, handler in heard.items()}
    with subprocess.Popen([*COMMAND, "-o", folder, *more], env=environment, stderr=subprocess.PIPE) as demo:
        for number, handler in before.items():
            signal.signal(number, handler)
        log = folder / "server.log"
        wait_for(lambda: log.exists() and b"Started server process" in log.read_bytes())
        yield demo, int(log.read_text().split("Started server process [")[1].split("]")[0])


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_interruption_stops_the_service(tmp_path: Path, environment: dict[str, str], ending: signal.Signals) -> None:
    with started(tmp_path, environment, "--keep") as (demo, server):
        demo.send_signal(ending)
        while ending != signal.SIGINT and demo.poll() is None:  # a terminal that closes may say so several times
            demo.send_signal(ending)
            time.sleep(0.05)
        assert demo.wait(120) in (128 + ending, -ending)
    wait_for(lambda: not alive(server))
    assert [path.name for path in tmp_path.iterdir()] == ["server.log"]


def test_a_demonstration_that_is_killed_leaves_no_service(tmp_path: Path, environment: dict[str, str]) -> None:
    with started(tmp_path, environment) as (demo, server):
        demo.kill()
        demo.wait(120)
    wait_for(lambda: not alive(server))


def test_failure_is_one_line_and_stops_the_service(tmp_path: Path, environment: dict[str, str]) -> None:
    """The file is a model of ours by all that it says, so that the service starts; the runtime cannot load it."""
    model = write_standin(tmp_path / "model.onnx")
    broken = onnx.load(model)
    broken.graph.node[0].op_type = "Nonsense"
    onnx.save(broken, model)
    out = tmp_path / "out"
    words = [*COMMAND, "-o", out, "--keep"]
    done = subprocess.run(words, env=environment | {"GAPMES_MODEL": str(model)}, capture_output=True, text=True)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    lines = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert len(lines) == 1
    assert "stage 'model'" in lines[0]
    assert str(out / "server.log") in lines[0]
    log = (out / "server.log").read_text()
    assert str(model) in log
    server = int(log.split("Started server process [")[1].split("]")[0])
    assert not alive(server)
    assert [path.name for path in out.iterdir()] == ["server.log"]


def test_a_setting_that_is_none_is_refused_before_anything_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("GAPMES_PORT", "abc")
    assert run("demo", "-o", tmp_path / "out", "--keep", "--json") == 1
    assert_refusal(capfd, "GAPMES_PORT")
    assert not (tmp_path / "out").exists()


def test_a_service_that_ends_is_quoted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("GAPMES_MODEL", "/nonexistent")
    assert run("demo", "-o", tmp_path, "-q", "--json") == 1
    error = assert_refusal(capfd, "error: the service ended with code 1: ")
    assert "/nonexistent" in error["detail"]
    assert (error["code"], error["cure"]) == ("internal_error", f"see {tmp_path / 'server.log'}")
