"""`gapmes serve` in processes: it ends in order on request, and a killed worker loses nothing."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
import uvicorn
from cli_runs import run
from http_requests import photograph, post
from served_process import serving, until

from gapmes.service.commands.listening import check_address
from gapmes.service.errors import InputError
from gapmes.service.scenes.database import Database


@pytest.fixture
def refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A refused start: no process may be started."""
    monkeypatch.setattr(uvicorn, "run", None)


def one_line(capfd: pytest.CaptureFixture[str]) -> str:
    line, *more = capfd.readouterr().err.splitlines()
    assert more == []
    return line


@pytest.mark.usefixtures("refused")
@pytest.mark.parametrize("workers", [1, 2])
def test_a_store_that_is_refused_is_refused_once(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], workers: int
) -> None:
    """Not by each worker in turn, each of which would be replaced."""
    with Database(tmp_path / "index.sqlite").write() as connection:
        connection.execute("PRAGMA user_version = 99")
    (tmp_path / "file").write_text("no folder")
    for store, why in ((tmp_path, "has version 99"), (tmp_path / "file" / "scenes", "Not a directory")):
        assert run("serve", "--workers", workers, "--store", store) == 1
        line = one_line(capfd)
        assert line.startswith(f"error: store: {store}")
        assert why in line


@pytest.mark.usefixtures("refused")
def test_a_name_that_is_nearly_a_setting_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("GAPMES_WORKER", "2")
    assert run("serve", "--store", tmp_path) == 1
    assert one_line(capfd) == "error: GAPMES_WORKER: is no setting (set GAPMES_WORKERS if that is meant, or unset it)"


@pytest.mark.usefixtures("refused")
@pytest.mark.parametrize("workers", [1, 2])
def test_an_address_that_cannot_be_listened_on_is_refused_once(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], workers: int
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        for host, field, why in (
            ("127.0.0.1", "port", f"port {port} of 127.0.0.1: Address already in use"),
            ("0.0.0.0", "port", f"port {port} of 0.0.0.0: Address already in use"),
            ("localhost", "port", f"port {port} of localhost: Address already in use"),
            ("192.0.2.1", "host", "'192.0.2.1': Cannot assign requested address"),
            ("no..name", "host", "'no..name': "),
        ):
            assert run("serve", "--workers", workers, "--host", host, "--port", port, "--store", tmp_path) == 1
            assert one_line(capfd).startswith(f"error: {field}: the service cannot listen on {why}")


@pytest.mark.skipif(not socket.has_dualstack_ipv6(), reason="no IPv6 here")
def test_all_of_ipv6_is_all_of_ipv4_too_for_several_workers() -> None:
    """As the server binds it; for one process it is not."""
    with socket.create_server(("0.0.0.0", 0)) as taken:
        port = taken.getsockname()[1]
        check_address("::", port, 1)
        with pytest.raises(InputError, match=f"cannot listen on port {port} of ::: Address already in use") as caught:
            check_address("::", port, 2)
    assert caught.value.field == "port"
    check_address("::", port, 2)


def workers(process: subprocess.Popen[bytes]) -> list[int]:
    """The processes that answer, without the one that supervises them and the interpreter's own helper."""
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    return [int(pid) for pid in children if b"spawn_main" in known_of(int(pid), "cmdline")]


def known_of(pid: int, name: str) -> bytes:
    """A file of /proc, empty for a process that has ended."""
    try:
        return Path(f"/proc/{pid}/{name}").read_bytes()
    except OSError:
        return b""


def loaded_file(worker: int) -> Path:
    """What this worker makes when it is loaded."""
    names = known_of(worker, "environ").split(b"\0")
    folder = next((name for name in names if name.startswith(b"PROMETHEUS_MULTIPROC_DIR=")), b"=gone")
    return Path(folder.partition(b"=")[2].decode()) / f"loaded_{worker}"


def test_who_is_told_that_it_is_ready_finds_no_worker_that_is_not(tmp_path: Path, standin_model: Path) -> None:
    """Neither at first, nor while a worker that was killed is being replaced: each question may meet another worker."""
    with serving(tmp_path / "scenes", standin_model, tmp_path / "log", "--workers", "2") as (client, process):
        killed, other = workers(process)
        os.kill(killed, signal.SIGKILL)
        told: list[int] = []

        def asked_until_replaced() -> bool:
            try:
                told.append(httpx.get(f"{client.base_url}/readyz", timeout=120).status_code)
            except httpx.TransportError:  # it was the victim's to answer
                told.append(0)
            return any(loaded_file(worker).exists() for worker in workers(process) if worker not in (killed, other))

        until(asked_until_replaced, 300, pause=0)
        told += [httpx.get(f"{client.base_url}/readyz", timeout=120).status_code for _ in range(20)]
        assert set(told) <= {0, 200}
        assert told.count(200) > 10


def test_workers_are_replaced_on_sighup_and_end_with_who_watches_them(tmp_path: Path, standin_model: Path) -> None:
    """Also where that one is killed: a worker by itself would hold the port, and nobody would replace it."""
    with serving(tmp_path / "scenes", standin_model, tmp_path / "log", "--workers", "2") as (client, process):
        first = workers(process)
        process.send_signal(signal.SIGHUP)
        until(lambda: len(workers(process)) == 2 and not set(workers(process)) & set(first), 300)
        last = workers(process)
        shared = loaded_file(last[0]).parent
        assert shared.is_dir()
        assert httpx.get(f"{client.base_url}/readyz", timeout=120).status_code == 200
        process.kill()
        process.wait()
        until(lambda: not any(known_of(pid, "cmdline") for pid in last))
        assert not shared.exists()
        with pytest.raises(httpx.ConnectError):
            httpx.get(f"{client.base_url}/healthz")


@pytest.mark.parametrize("workers", [1, 2])
def test_it_serves_and_ends_where_all_streams_are_closed(tmp_path: Path, standin_model: Path, workers: int) -> None:
    more = {"shell": "<&- >&- 2>&-", "GAPMES_WORKERS": str(workers)}
    with serving(tmp_path / "scenes", standin_model, tmp_path / "log", **more) as (client, process):
        assert post(client).status_code == 201
        process.send_signal(signal.SIGTERM)
        assert process.wait(120) == 0


def test_a_full_log_does_not_keep_it_from_ending(tmp_path: Path, standin_model: Path) -> None:
    more = {"shell": ">/dev/full 2>&1", "PYTHONUNBUFFERED": ""}
    with serving(tmp_path / "scenes", standin_model, tmp_path / "log", **more) as (_, process):
        process.send_signal(signal.SIGTERM)
        assert process.wait(120) == 0


@contextmanager
def hangup(action: signal.Handlers) -> Iterator[None]:
    """What processes that are started meanwhile do about SIGHUP unless they decide otherwise."""
    before = signal.signal(signal.SIGHUP, action)
    try:
        yield
    finally:
        signal.signal(signal.SIGHUP, before)


def test_it_ends_in_order_with_its_terminal(tmp_path: Path, standin_model: Path) -> None:
    """One process, that is: several are replaced by that signal."""
    with hangup(signal.SIG_DFL), serving(tmp_path / "scenes", standin_model, tmp_path / "log") as (_, process):
        process.send_signal(signal.SIGHUP)
        assert process.wait(120) == 0
    assert "Application shutdown complete" in (tmp_path / "log").read_text()


def test_it_outlives_its_terminal_where_that_is_asked_for(tmp_path: Path, standin_model: Path) -> None:
    """For example with nohup."""
    with hangup(signal.SIG_IGN), serving(tmp_path / "scenes", standin_model, tmp_path / "log") as (client, process):
        process.send_signal(signal.SIGHUP)
        assert post(client).status_code == 201
        assert httpx.get(f"{client.base_url}/healthz", timeout=120).status_code == 200  # over a connection of its own
        process.send_signal(signal.SIGTERM)
        assert process.wait(120) == 0


def test_it_ends_in_order_with_what_it_has_begun(tmp_path: Path, standin_model: Path) -> None:
    """SIGTERM while a scene is being asked for and a stream is open: the scene is answered, the stream ends, exit 0."""
    environment = {"GAPMES_LOG": "json", "GAPMES_DRAIN_SECONDS": "100"}  # as long as a busy machine may take
    with serving(tmp_path / "scenes", standin_model, tmp_path / "log", **environment) as (client, process):
        found: list[Any] = []
        job = post(client, prefer="respond-async").json()
        until(lambda: client.get(job["links"]["self"]).json()["state"] == "done")
        streams = httpx.Client(base_url=client.base_url, timeout=120)
        big = [photograph(k, 1600, 1200) for k in (1, 2, 3)]
        cameras = cameras_of(3, 1600, 1200)
        work = threading.Thread(target=lambda: found.append(post(client, big, cameras)))
        work.start()
        until(lambda: running(streams), pause=0)
        # the same scene as a job, whose stream is open while the process is told to end
        job = post(httpx.Client(base_url=client.base_url, timeout=120), big, cameras, prefer="respond-async").json()
        with streams.stream("GET", job["links"]["events"]) as stream:
            process.send_signal(signal.SIGTERM)
            told = "".join(stream.iter_text())
        assert told.startswith("retry: ")
        assert process.wait(120) == 0
        work.join()
        assert found[0].status_code in (200, 201)
    log = (tmp_path / "log").read_text()
    assert "Traceback" not in log
    assert '"message": "POST /reconstruct 20' in log


def cameras_of(count: int, width: int, height: int) -> dict[str, Any]:
    from http_requests import camera_object

    cameras = camera_object(count, width=width, height=height)
    for view in cameras["views"]:
        view["fx"] = view["fy"] = 0.9 * width
    return cameras


def running(client: httpx.Client) -> bool:
    return 'gapmes_jobs_active{state="running"} 1.0' in client.get("/metrics").text


def test_workers_share_a_store_and_one_that_is_killed_is_replaced(tmp_path: Path, standin_model: Path) -> None:
    """Whatever a client was told is there stays there; what it was not told may be asked for again."""
    with serving(tmp_path / "scenes", standin_model, tmp_path / "log", "--workers", "2") as (client, process):
        until(lambda: len(workers(process)) == 2)
        acknowledged: dict[str, bytes] = {}
        jobs = [
            post(client, [photograph(k), photograph(k + 1)], prefer="respond-async").json() for k in range(0, 12, 2)
        ]
        for victim in workers(process)[:1]:
            os.kill(victim, signal.SIGKILL)
        for k in range(20, 30, 2):
            for _ in range(20):
                try:
                    answer = post(client, [photograph(k), photograph(k + 1)], accept="application/octet-stream")
                    break
                except httpx.TransportError:  # it was the victim's to answer
                    time.sleep(0.1)
            assert answer.status_code in (200, 201), answer.text
            acknowledged[answer.headers["location"]] = answer.content
        until(lambda: all(client.get(job["links"]["self"]).json()["state"] == "done" for job in jobs))
        for location, body in acknowledged.items():
            assert client.get(location + ".ply").content == body
        until(lambda: len(workers(process)) == 2)
        total = sum(
            float(line.split()[-1])
            for line in client.get("/metrics").text.splitlines()
            if line.startswith("gapmes_scenes ")
        )
        assert total == len(acknowledged) + len(jobs)
        process.send_signal(signal.SIGTERM)
        assert process.wait(120) == 0
