"""The cost of a request: headers are read once, nothing long runs on the event loop, no body is read before a full
queue."""

from __future__ import annotations

import asyncio
import encodings
import errno
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from format_cases import moderate
from http_requests import assert_problem, camera_object, photograph, post, stored, wait_until_ready
from starlette.testclient import TestClient

from gapmes.service.app import create_app
from gapmes.service.errors import GapmesError, ServiceBusy, StorageFull
from gapmes.service.formats.ply import ply_bytes
from gapmes.service.http import inputs, pairing
from gapmes.service.pictures.picture import png
from gapmes.service.scenes.database import Database
from gapmes.service.scenes.scene_index import SceneIndex
from gapmes.service.scenes.store import SceneStore
from gapmes.service.settings import Settings


def transforms(count: int) -> dict[str, Any]:
    """Frames without sizes that all name one of the two posted images."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0]).tolist()
    frames = [{"file_path": f"{index % 2}.png", "transform_matrix": pose} for index in range(count)]
    return {"fl_x": 80.0, "fl_y": 80.0, "frames": frames}


def test_the_header_of_an_image_is_read_once(client: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    read = []
    original = pairing.image_size
    monkeypatch.setattr(
        pairing, "image_size", lambda data, **options: read.append(options["index"]) or original(data, **options)
    )
    assert_problem(post(client, cameras=transforms(300)), 422, "view_count", "cameras")
    assert read == []  # names and counts are compared before a camera is parsed
    assert_problem(post(client, cameras=transforms(2)), 422, "no_baseline")
    assert read == [0, 1]


@pytest.mark.parametrize("kind", ["views", "frames"])
def test_too_many_cameras(client: TestClient, kind: str) -> None:
    camera = camera_object(1)["views"][0] | {"c2w": 0}
    cameras = transforms(2001) if kind == "frames" else {"views": [camera] * 2001}
    body = assert_problem(post(client, cameras=cameras), 422, "invalid_input", "cameras")
    assert body["detail"] == "has 2001 views, the limit is 2000"


def watched(monkeypatch: pytest.MonkeyPatch, *functions: tuple[Any, str]) -> dict[str, set[bool]]:
    """By name of a function, of an owner each, whether its calls were on the event loop's thread."""
    on_loop: dict[str, set[bool]] = {name: set() for _, name in functions}

    def watch(owner: Any, name: str) -> None:
        original = getattr(owner, name)

        def noted(*args: Any, **options: Any) -> Any:
            try:
                asyncio.get_running_loop()
                on_loop[name].add(True)
            except RuntimeError:
                on_loop[name].add(False)
            return original(*args, **options)

        monkeypatch.setattr(owner, name, noted)

    for owner, name in functions:
        watch(owner, name)
    return on_loop


def test_parsing_and_hashing_leave_the_event_loop_alone(client: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    functions = ((inputs, "parse_json"), (inputs, "table_of_bytes"), (inputs, "match_names"), (SceneStore, "scene_id"))
    on_loop = watched(monkeypatch, *functions)
    assert post(client).status_code in (200, 201)
    assert on_loop == {name: {False} for _, name in functions}


def test_noting_that_a_scene_is_read_leaves_the_event_loop_alone(
    client: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It may be a write, which waits where another program has locked the index."""
    links = post(client).json()["links"]
    on_loop = watched(monkeypatch, (SceneIndex, "used"))
    for link in (*links["files"].values(), links["views"][0], links["preview"], links["sheet"], links["inputs"][0]):
        assert client.get(link).status_code == 200
    assert client.get(f"{links['self']}/viewer.ply").status_code == 200
    assert on_loop == {"used": {False}}


def test_a_full_queue_answers_before_the_body_is_read(client: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    request = post(client).request
    monkeypatch.setattr(client.app.state.runtime.jobs.table, "_most", -1)  # a slot is free, which is a place, too
    sent: list[dict[str, Any]] = []

    async def receive() -> dict[str, Any]:
        raise AssertionError("the body was asked for")

    async def send(message: dict[str, Any]) -> None:
        sent.append(message)

    headers = [(b"content-type", request.headers["content-type"].encode())]
    scope = {"type": "http", "method": "POST", "path": "/reconstruct", "query_string": b"", "headers": headers}
    asyncio.run(client.app(scope, receive, send))
    assert sent[0]["status"] == 503
    assert b"service_busy" in sent[1]["body"]


def test_stalled_uploads_expire_and_keep_nobody_from_the_cpu(settings: Settings, tmp_path: Path) -> None:
    """One sender stops after its headers: renders go on, a second upload is told to wait, the first gets 408."""
    update = {"store": tmp_path, "max_uploads": 1, "max_waiting": 0, "upload_seconds": 4.0}
    with TestClient(create_app(settings.model_copy(update=update)), raise_server_exceptions=False) as client:
        wait_until_ready(client)
        assert post(client).status_code == 201
        headers = [(b"content-type", b"multipart/form-data; boundary=x")]
        scope = {"type": "http", "method": "POST", "path": "/reconstruct", "query_string": b"", "headers": headers}
        sent: list[dict[str, Any]] = []

        async def stalled() -> None:
            async def receive() -> dict[str, Any]:
                await asyncio.sleep(3600)
                raise AssertionError("never")

            async def send(message: dict[str, Any]) -> None:
                sent.append(message)

            await client.app(scope, receive, send)

        waiting = client.portal.start_task_soon(stalled)
        while client.app.state.runtime.uploads.taken == 0:
            time.sleep(0.01)
        assert_problem(post(client), 503, "service_busy")
        assert client.get("/render?view=0").status_code == 200
        waiting.result(timeout=120)
        assert sent[0]["status"] == 408
        assert b"upload_timeout" in sent[1]["body"]
        assert post(client).status_code == 200


def test_pixels_of_a_request_together(settings: Settings, tmp_path: Path) -> None:
    limited = create_app(settings.model_copy(update={"store": tmp_path, "max_request_pixels": 2 * 96 * 72}))
    with TestClient(limited, raise_server_exceptions=False) as client:
        wait_until_ready(client)
        for prefer in (None, "respond-async"):
            answer = post(client, [photograph(i) for i in range(3)], prefer=prefer)
            body = assert_problem(answer, 413, "image_too_large", "images")
            assert body["detail"] == "the 3 photographs have 20736 pixels together, the limit is 13824"
        assert post(client).status_code == 201


@pytest.mark.parametrize("charset", ["punycode", "PunyCode", '" punycode "', "idna"])
@pytest.mark.parametrize("route", ["/check", "/reconstruct", "/scenes"])
def test_a_codec_for_names_of_hosts_is_no_charset(client: TestClient, route: str, charset: str) -> None:
    """Decoding takes time with the cube of a field's length, on the thread that answers everybody: 6 s for 100 kB."""
    request = client.build_request("POST", route, files={"cameras-": b"x-" + b"b" * 1000})
    kind = request.headers["content-type"].replace("form-data;", f"form-data; charset={charset};")
    answer = client.post(route, content=request.read(), headers={"content-type": kind})
    body = assert_problem(answer, 400, "malformed_request", "Content-Type", cured=True)
    name = charset.lower().strip('" ')
    assert body["detail"] == f"its charset is {name}, need one of text"


@pytest.mark.parametrize(("length", "status"), [(40, 201), (41, 400), (50_000, 400)])
def test_a_charset_with_a_long_name_is_none(client: TestClient, length: int, status: int) -> None:
    """Python keeps every name of which it has no codec: each request took the size of its header for good."""
    request = client.build_request("POST", "/scenes", files={"file": ("a.ply", ply_bytes(moderate(9, length, 0)))})
    name = "x" * length
    kind = request.headers["content-type"].replace("form-data;", f"form-data; charset={name};")
    answer = client.post("/scenes", content=request.read(), headers={"content-type": kind})
    if status == 201:  # as before: what is unknown is taken for latin-1
        assert answer.status_code == 201
        return
    body = assert_problem(answer, 400, "malformed_request", "Content-Type", cured=True)
    assert body["detail"] == f"its charset has a name of {length} characters, need at most 40"
    assert name not in encodings._cache  # type: ignore[attr-defined]


def test_a_charset_that_decodes_nothing(client: TestClient) -> None:
    """Python has a codec of this name, which refuses everything with an error of its own."""
    request = post(client).request
    kind = request.headers["content-type"].replace("form-data;", "form-data; charset=undefined;")
    answer = client.post("/reconstruct", content=request.read(), headers={"content-type": kind})
    assert_problem(answer, 400, "malformed_request", "body")


@pytest.mark.parametrize("file", ["scene.ply", "scene.json", "1", "work.json"])
def test_a_full_disk_is_507_and_nothing_is_broken(
    settings: Settings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str
) -> None:
    """Whichever file has no room: what is there is served, nothing half is left, and later it works."""
    own = settings.model_copy(update={"store": tmp_path})
    with TestClient(create_app(own), raise_server_exceptions=False) as client:
        wait_until_ready(client)
        there = post(client).json()
        before = stored(own)
        original = Path.open

        def full(path: Path, mode: str = "r", *arguments: Any, **options: Any) -> Any:
            if path.name == file and ("w" in mode or "x" in mode):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return original(path, mode, *arguments, **options)

        with monkeypatch.context() as patch:
            patch.setattr(Path, "open", full)
            assert_problem(post(client, [photograph(60), photograph(61)]), 507, "storage_full", "store")
            assert client.get("/render", params={"scene": there["id"]}).status_code == 200
            assert client.get(there["links"]["ply"]).status_code == 200
        assert stored(own) == before
        assert post(client, [photograph(60), photograph(61)]).status_code == 201


@pytest.mark.parametrize("owner", [tempfile, Path])
def test_a_film_that_finds_no_room_is_507(client: TestClient, monkeypatch: pytest.MonkeyPatch, owner: Any) -> None:
    """For its folder, or for the film itself. Both are not in the store, which has nothing to do with it."""
    link = post(client).json()["links"]["preview"]

    def full(*_: Any, **__: Any) -> Any:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(owner, "mkdtemp" if owner is tempfile else "replace", full)
    problem = assert_problem(client.get(link, params={"frames": 2}), 507, "storage_full", "TMPDIR")
    assert "scenes" not in problem["cure"]


def test_a_large_upload_that_finds_no_room_is_507(client: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any, **__: Any) -> Any:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    noise = np.random.default_rng(0).integers(0, 256, (640, 640, 3), dtype=np.uint8)
    large = png(noise)
    assert len(large) > 2**20  # what python keeps in memory
    monkeypatch.setattr(tempfile.SpooledTemporaryFile, "rollover", full)
    assert_problem(post(client, [large, photograph(1)]), 507, "storage_full", "TMPDIR")


@pytest.mark.parametrize(
    ("error", "status", "code"), [(StorageFull, 507, "storage_full"), (ServiceBusy, 503, "service_busy")]
)
def test_a_full_disk_or_a_locked_index_keeps_the_service_from_nothing_but_writing(
    settings: Settings,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    error: type[GapmesError],
    status: int,
    code: str,
) -> None:
    """Started anew after a crash, with an index that takes nothing more: it becomes ready, and shows what is there."""
    own = settings.model_copy(update={"store": tmp_path, "drain_seconds": 1.0})
    with TestClient(create_app(own), raise_server_exceptions=False) as client:
        wait_until_ready(client)
        scene = post(client).json()
    with Database(tmp_path / "index.sqlite").write() as connection:
        job = "INSERT INTO jobs (id, scene_id, state, kept, owner, created) VALUES ('1', '2', 'running', 1, 'gone', 0)"
        connection.execute(job)

    def refused(*_: Any) -> None:
        raise error("the index cannot be written")

    with monkeypatch.context() as patch:
        patch.setattr(Database, "write", refused)
        with TestClient(create_app(own), raise_server_exceptions=False) as client:
            wait_until_ready(client)
            assert client.get("/render", params={"scene": scene["id"]}).status_code == 200
            assert client.get(scene["links"]["ply"]).status_code == 200
            assert [one["id"] for one in client.get("/scenes").json()["scenes"]] == [scene["id"]]
            assert_problem(post(client, [photograph(70), photograph(71)]), status, code)
