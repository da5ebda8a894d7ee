"""A local service that fails, and a full disk under the files of the demonstration: the reason is reported."""

from __future__ import annotations

import errno
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from full_disk import contents, full_disk

from gapmes.service import demo
from gapmes.service.errors import DepthRangeError, GapmesError, StorageFull
from gapmes.service.local_server import checked, local_client, wait_until_ready
from gapmes.service.process.terminal import ProgressBars
from gapmes.service.progress import Stages


def ended(log: Path) -> None:
    """Waits for a service that has ended and said what is in the log."""
    with subprocess.Popen([sys.executable, "-c", "raise SystemExit(3)"]) as process:
        process.wait(120)
        wait_until_ready(local_client("http://127.0.0.1:9", 1), process, log, Stages())


def test_a_service_that_said_nothing_is_asked_whether_the_disk_is_full(tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.write_text("")
    with full_disk(), pytest.raises(StorageFull, match=f"no space for what the service writes into {tmp_path}"):
        ended(log)
    with pytest.raises(GapmesError, match="the service ended with code 3 ") as caught:
        ended(log)
    assert type(caught.value) is GapmesError
    log.write_text("first\nerror: the last\n\n")
    with full_disk(), pytest.raises(GapmesError, match="the service ended with code 3: the last "):
        ended(log)


def answer(status: int, code: str, **more: Any) -> httpx.Response:
    request = httpx.Request("POST", "http://127.0.0.1/reconstruct")
    return httpx.Response(status, json={"code": code, "detail": "why"} | more, request=request)


@pytest.mark.parametrize(
    ("status", "code", "kind"),
    [
        (507, "storage_full", StorageFull),
        (422, "depth_range_invalid", DepthRangeError),
        (500, "internal_error", GapmesError),
        (500, "of_another_time", GapmesError),
    ],
)
def test_a_refusal_of_the_service_keeps_its_code(status: int, code: str, kind: type[GapmesError]) -> None:
    with pytest.raises(GapmesError, match=f"near: POST /reconstruct -> {status} {code}: why") as caught:
        checked(answer(status, code, field="near", index=2))
    assert type(caught.value) is kind
    assert (caught.value.status, caught.value.index) == (status, 2)


@pytest.mark.parametrize("before", [{}, {"scene.ply": b"as it was"}])
def test_a_full_disk_leaves_no_half_of_a_file_and_is_told_with_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, before: dict[str, bytes]
) -> None:
    for name, data in before.items():
        (tmp_path / name).write_bytes(data)

    @contextmanager
    def served(*_: object, **__: object) -> Iterator[tuple[str, Any]]:
        yield "http://127.0.0.1:9", None

    def answered(request: httpx.Request) -> httpx.Response:
        scene = {"id": "1", "links": {"ply": "/1/ply"}, "timings": {}}
        return httpx.Response(200, json=scene) if request.method == "POST" else httpx.Response(200, content=bytes(9999))

    client = httpx.Client(base_url="http://127.0.0.1:9", transport=httpx.MockTransport(answered))
    monkeypatch.setattr(demo, "local_server", served)
    monkeypatch.setattr(demo, "local_client", lambda *_: client)
    monkeypatch.setattr(demo, "wait_until_ready", lambda *_: None)
    with full_disk(), pytest.raises(OSError, match="large") as caught:
        demo.run_demo(tmp_path, ProgressBars(quiet=True))
    assert (caught.value.errno, caught.value.filename) == (errno.EFBIG, str(tmp_path / "scene.ply"))
    assert contents(tmp_path) == before
