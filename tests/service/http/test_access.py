"""Access and its answers: the key, other origins, ids, counts, tags and ranges."""

from __future__ import annotations

import json
import logging
import re
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from http_requests import assert_problem, photograph, post, wait_until_ready
from starlette.testclient import TestClient

from gapmes.service.app import create_app
from gapmes.service.errors import InputError
from gapmes.service.process.logs import REQUEST_ID, configure
from gapmes.service.settings import Settings

KEY = "a key, of some length"


@pytest.fixture(scope="module")
def locked(settings: Settings, tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    folder = tmp_path_factory.mktemp("locked")
    (folder / "key").write_text(KEY + "\n")
    changed = {
        "store": folder / "scenes", "api_key_file": folder / "key", "cors_origins": "https://one.example, https://two.example",
    }  # fmt: skip
    with TestClient(create_app(settings.model_copy(update=changed)), raise_server_exceptions=False) as client:
        wait_until_ready(client)
        yield client


@pytest.mark.parametrize(
    ("method", "path"),
    [("GET", "/scenes"), ("POST", "/reconstruct"), ("GET", "/render"), ("GET", "/metrics"), ("DELETE", "/scenes/x"),
     ("GET", "/jobs/x"), ("GET", "/jobs/x/events"), ("GET", "/openapi.json"), ("GET", "/nowhere")],
)  # fmt: skip
@pytest.mark.parametrize(
    "headers",
    [{}, {"Authorization": "Bearer wrong"}, {"Authorization": KEY}, {"X-API-Key": KEY + "x"}, {"X-API-Key": ""},
     {"Authorization": "Bearer \xff"}],
)  # fmt: skip
def test_without_the_key_nothing_is_told(locked: TestClient, method: str, path: str, headers: dict[str, str]) -> None:
    sent = {name: value.encode("latin-1") for name, value in headers.items()}
    answer = locked.request(method, path, headers=sent)
    assert_problem(answer, 401, "unauthorized", "Authorization")
    assert answer.headers["www-authenticate"].startswith("Bearer")


@pytest.mark.parametrize(
    "headers", [{"Authorization": f"Bearer {KEY}"}, {"authorization": f"bearer {KEY}"}, {"X-API-Key": KEY}]
)
def test_with_the_key_all_is_open(locked: TestClient, headers: dict[str, str]) -> None:
    assert locked.get("/scenes", headers=headers).status_code == 200
    assert locked.get("/metrics", headers=headers).status_code == 200


@pytest.mark.parametrize("path", ["/", "/static/js/main.js", "/healthz", "/readyz"])
def test_probes_and_the_page_need_no_key(locked: TestClient, path: str) -> None:
    assert locked.get(path).status_code == 200


def test_a_key_file_that_is_none_is_refused_at_start(tmp_path: Path) -> None:
    (tmp_path / "empty").write_text(" \n")
    for name in ("empty", "missing"):
        with pytest.raises(InputError) as caught:
            create_app(Settings(store=tmp_path / "scenes", api_key_file=tmp_path / name))
        assert caught.value.field == "GAPMES_API_KEY_FILE"
        assert caught.value.cure


@pytest.mark.parametrize(
    ("key", "index"), [("schlüssel", 4), ("tab\tin it", 3), ("two\nlines", 3), (" before", None), ("behind ", None)]
)
def test_a_key_that_no_request_can_bring_is_refused(key: str, index: int | None) -> None:
    with pytest.raises(InputError) as caught:
        Settings(api_key=key).key()
    assert (caught.value.field, caught.value.index) == ("GAPMES_API_KEY", index)
    assert caught.value.cure is not None
    assert key.strip() not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "index"),
    [("schlüssel".encode(), 4), ("schlüssel".encode("latin-1"), 4), (b"\xef\xbb\xbfkey", 0), (b"two\nlines", 3)],
)
def test_a_key_file_that_no_request_can_bring_is_refused(tmp_path: Path, content: bytes, index: int) -> None:
    (tmp_path / "key").write_bytes(b"\r\n " + content + b" \n")
    with pytest.raises(InputError, match=f"character {index}, counted from 0, is not printable ASCII") as caught:
        Settings(api_key_file=tmp_path / "key").key()
    assert (caught.value.field, caught.value.index) == ("GAPMES_API_KEY_FILE", index)


def test_two_keys_are_refused(tmp_path: Path) -> None:
    (tmp_path / "key").write_text(KEY)
    with pytest.raises(InputError, match="GAPMES_API_KEY_FILE") as caught:
        Settings(api_key=KEY, api_key_file=tmp_path / "key").key()
    assert caught.value.field == "GAPMES_API_KEY"
    assert KEY not in str(caught.value)


def test_the_key_is_not_shown() -> None:
    assert KEY not in repr(Settings(api_key=KEY))
    assert Settings(api_key=KEY).key() == KEY
    with pytest.raises(InputError, match="is empty"):
        Settings(api_key="").key()


def test_other_origins(client: TestClient, locked: TestClient) -> None:
    asked = {
        "Origin": "https://two.example",
        "Access-Control-Request-Method": "POST",
        "Access-Control-Request-Headers": "authorization",
    }
    preflight = locked.options("/reconstruct", headers=asked)
    assert preflight.status_code == 200
    assert preflight.headers["access-control-allow-origin"] == "https://two.example"
    assert locked.options("/reconstruct", headers=asked | {"Origin": "https://other.example"}).status_code == 400
    refused = locked.get("/scenes", headers={"Origin": "https://one.example"})
    assert refused.headers["access-control-allow-origin"] == "https://one.example"  # so that a page can read why
    for answer in (
        client.get("/scenes", headers={"Origin": "https://one.example"}),
        client.options("/scenes", headers=asked),
    ):
        assert not [name for name in answer.headers if name.startswith("access-control")]


def test_every_answer_has_an_id(client: TestClient) -> None:
    assert client.get("/scenes", headers={"X-Request-ID": "mine-1.2:3"}).headers["x-request-id"] == "mine-1.2:3"
    for brought in ("", "a b", "x" * 65, "<script>"):
        found = client.get("/nowhere", headers={"X-Request-ID": brought}).headers["x-request-id"]
        assert re.fullmatch("[0-9a-f]{32}", found)


def test_a_fault_keeps_its_id(
    client: TestClient, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("secret")

    monkeypatch.setattr(client.app.state.runtime.store, "page", broken)
    answer = client.get("/scenes", headers={"X-Request-ID": "mine"})
    assert_problem(answer, 500, "internal_error")
    assert answer.headers["x-request-id"] == "mine"
    assert [record.request_id for record in caplog.records if record.levelno == logging.ERROR] == ["mine"]


def test_neither_methods_nor_paths_get_into_numbers_and_lines(
    client: TestClient, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO):
        client.request("BREW", "/scenes")
        client.get("/a%0aGET /scenes/x 204%1b[2J")
    assert 'method="other"' in client.get("/metrics").text
    assert "BREW" not in client.get("/metrics").text
    lines = [record.getMessage() for record in caplog.records if record.name == "gapmes.access"]
    assert lines[0].startswith("other /scenes ")
    assert lines[1] == "GET /a%0AGET%20/scenes/x%20204%1B%5B2J 404"


def test_a_line_of_the_log_tells_what_was_answered(client: TestClient, caplog: pytest.LogCaptureFixture) -> None:
    """And which job a request belongs to; probes are not logged."""
    made = post(client)
    link = f"/scenes/{made.json()['id']}"
    with caplog.at_level(logging.INFO, "gapmes.access"):
        job = post(client, prefer="respond-async")
        answers = [job, client.get(link), client.get(f"{link}.ply"), client.get("/render?view=99")]
        client.get("/healthz")
    lines = [record.__dict__ for record in caplog.records if record.name == "gapmes.access"]
    statuses = [line["message"].rsplit(" ", 1) for line in lines]
    assert statuses == [
        ["POST /reconstruct", "202"], [f"GET {link}", "200"], [f"GET {link}.ply", "200"], ["GET /render", "422"]
    ]  # fmt: skip
    assert [line["bytes"] for line in lines] == [len(answer.content) for answer in answers]
    assert (lines[2]["route"], lines[3]["route"]) == ("/scenes/{scene_id:before_dot}.{extension}", "/render")
    assert [line.get("job") for line in lines] == [job.json()["id"], None, None, None]


def test_nothing_of_the_host_is_told(client: TestClient) -> None:
    for path in ("/", "/scenes", "/nowhere", "/healthz"):
        headers = client.get(path).headers
        assert "server" not in headers
        assert headers["x-content-type-options"] == "nosniff"


def count(client: TestClient, name: str) -> float:
    lines = client.get("/metrics").text.splitlines()
    return sum(float(line.rpartition(" ")[2]) for line in lines if line.startswith(name))


def test_probes_answer_without_a_body_too(client: TestClient) -> None:
    for path in ("/healthz", "/readyz"):
        assert client.head(path).status_code == 200


def test_what_happens_is_counted(client: TestClient) -> None:
    post(client)
    before = {name: count(client, name) for name in (
        'gapmes_requests_total{method="GET",route="/render",status="200"}',
        'gapmes_rejected_total{code="view_unknown"}',
        'gapmes_jobs_total{state="done"}', 'gapmes_stage_seconds_count{stage="network"}', "gapmes_scenes ",
        'gapmes_gaussians_total{fate="kept"}', 'gapmes_gaussians_total{fate="dropped"}',
        'gapmes_request_seconds_count{route="/render"}',
        'gapmes_stage_seconds_count{stage="draw"}',
    )}  # fmt: skip
    scene = post(client, [photograph(200), photograph(201)]).json()
    deadline = time.monotonic() + 120
    while count(client, 'gapmes_jobs_total{state="done"}') == before['gapmes_jobs_total{state="done"}']:
        assert time.monotonic() < deadline  # a job is counted a moment after its end
    assert client.get("/render", params={"scene": scene["id"]}).status_code == 200
    assert client.get("/render?view=99").status_code == 422
    after = {name: count(client, name) - value for name, value in before.items()}
    kept = after.pop('gapmes_gaussians_total{fate="kept"}')
    assert kept == scene["gaussians"]["count"]
    left_out = [row for row in scene["left_out"] if row["what"].startswith("Gaussians")]
    dropped = after.pop('gapmes_gaussians_total{fate="dropped"}')
    assert dropped == left_out[0]["of"] - kept > 0
    assert after.pop('gapmes_request_seconds_count{route="/render"}') == 2
    assert after == dict.fromkeys(after, 1)
    assert count(client, "gapmes_scenes_bytes") > 0
    client.delete(scene["links"]["self"])


def test_the_log_is_json_with_the_id(capsys: pytest.CaptureFixture[str]) -> None:
    root = logging.getLogger()
    before = root.handlers[:], root.level
    try:
        configure("json")
        token = REQUEST_ID.set("mine")
        logging.getLogger("gapmes.access").info("%s done", "it", extra={"seconds": 0.5})
        REQUEST_ID.reset(token)
        try:
            raise ZeroDivisionError("why")
        except ZeroDivisionError:
            logging.getLogger("gapmes").exception("failed")
        lines = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
        configure("text")
        logging.getLogger("gapmes").info("plain", extra={"seconds": 1})
        text = capsys.readouterr().err
    finally:
        root.handlers[:], root.level = before
    assert {"message": "it done", "seconds": 0.5, "request_id": "mine", "level": "info"}.items() <= lines[0].items()
    assert "ZeroDivisionError: why" in lines[1]["exception"]
    assert "request_id" not in lines[1]
    assert re.search(r"^\S+Z info +plain seconds=1$", text)


def test_a_file_has_a_tag_and_can_be_had_in_parts(client: TestClient) -> None:
    link = post(client).json()["links"]["ply"]
    whole = client.get(link)
    tag = whole.headers["etag"]
    assert whole.headers["accept-ranges"] == "bytes"
    for value in (tag, f'"x", {tag}', f"W/{tag}", "*"):
        answer = client.get(link, headers={"If-None-Match": value})
        assert (answer.status_code, answer.content, answer.headers["etag"]) == (304, b"", tag)
    assert client.get(link, headers={"If-None-Match": '"x"'}).status_code == 200
    head = client.head(link)
    assert (head.status_code, head.content, head.headers["etag"]) == (200, b"", tag)
    assert head.headers["content-length"] == str(len(whole.content))
    part = client.get(link, headers={"Range": "bytes=10-19"})
    assert (part.status_code, part.content) == (206, whole.content[10:20])
    assert part.headers["content-range"] == f"bytes 10-19/{len(whole.content)}"
    rest = client.get(link, headers={"Range": f"bytes={len(whole.content) - 5}-", "If-Range": tag})
    assert (rest.status_code, rest.content) == (206, whole.content[-5:])
    assert client.get(link, headers={"Range": "bytes=0-4", "If-Range": '"other"'}).content == whole.content
    beyond = client.get(link, headers={"Range": f"bytes={len(whole.content)}-"})
    assert_problem(beyond, 416, "range_not_satisfiable", "Range")
    assert beyond.headers["content-range"] == f"bytes */{len(whole.content)}"
    for none in ("bytes=abc", "lines=1-2", "bytes=-", "bytes=5-2", "bytes=0-4, 5-2", "bytes=,", ""):
        answer = client.get(link, headers={"Range": none})
        assert (answer.status_code, answer.content) == (200, whole.content), none


def test_a_picture_has_a_tag(client: TestClient) -> None:
    scene = post(client).json()["id"]
    first = client.get("/render", params={"scene": scene, "view": "0.5"})
    tag = first.headers["etag"]
    assert "max-age" in first.headers["cache-control"]
    assert re.search(r"draw;dur=[\d.]+, encode;dur=", first.headers["server-timing"])
    same = client.get("/render", params={"scene": scene, "view": "0.5"}, headers={"If-None-Match": tag})
    assert (same.status_code, same.content) == (304, b"")
    for more in ({"view": "0.25"}, {"view": "0.5", "width": "40"}, {"view": "0.5", "channel": "depth"}):
        answer = client.get("/render", params={"scene": scene, **more}, headers={"If-None-Match": tag})
        assert answer.status_code == 200
        assert answer.headers["etag"] != tag
    newest = client.get("/render", params={"view": "0.5"})
    assert newest.headers["cache-control"] == "no-cache"


def test_pages_of_scenes(client: TestClient) -> None:
    for seed in (210, 212, 214):
        post(client, [photograph(seed), photograph(seed + 1)])
    every = [scene["id"] for scene in client.get("/scenes?limit=1000").json()["scenes"]]
    found, after = [], None
    while True:
        page = client.get("/scenes", params={"limit": 2} | ({} if after is None else {"after": after})).json()
        assert len(page["scenes"]) <= 2
        found += [scene["id"] for scene in page["scenes"]]
        after = page["next"]
        if after is None:
            break
    assert found == every
    for bad in ("x", "1-x", "9" * 30 + "-" + "a" * 25, "9" * 19 + "-" + "a" * 32):
        assert_problem(client.get("/scenes", params={"after": bad}), 422, "invalid_input", "after")
    assert_problem(client.get("/scenes?limit=0"), 422, "parameter_invalid")
    body = assert_problem(client.get("/scenes?limits=2"), 422, "parameter_invalid", "limits")
    assert body["cure"] == "parameters: limit, after"


def test_the_open_api_says_how_the_key_is_brought(locked: TestClient, client: TestClient) -> None:
    schema = locked.get("/openapi.json", headers={"Authorization": f"Bearer {KEY}"}).json()
    schemes = schema["components"]["securitySchemes"]
    assert {name for one in schema["security"] for name in one} == set(schemes)
    assert schemes["bearer"]["scheme"] == "bearer"
    assert schemes["key"]["name"] == "X-API-Key"
    for path in ("/healthz", "/readyz"):
        assert schema["paths"][path]["get"]["security"] == []  # they need none
    assert "security" not in schema["paths"]["/metrics"]["get"]  # as said for all
    assert "security" not in client.get("/openapi.json").json()
