"""The service as a whole: probes, the page, errors of every kind, start-up without torch."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path

import anyio.to_thread
import pytest
from http_requests import assert_problem, photograph, post, wait_until_ready
from starlette.testclient import TestClient

from gapmes.service.app import create_app
from gapmes.service.errors import ModelError
from gapmes.service.http.page import STATIC, VIEWER
from gapmes.service.network.engine import Engine
from gapmes.service.reconstruct import Reconstructor
from gapmes.service.settings import Settings


def test_probes(client: TestClient) -> None:
    assert client.get("/healthz").json() == {"status": "ok"}
    ready = client.get("/readyz").json()
    assert ready["status"] == "ready"
    assert len(ready["model"]["weights_sha256"]) == 64
    assert set(ready["timings"]) == {"import", "model", "kernels"}


def test_a_probe_waits_for_no_thread_of_others(client: TestClient) -> None:
    """All may wait, as for an index that another program has locked."""
    assert client.portal is not None
    threads = client.portal.call(anyio.to_thread.current_default_thread_limiter)
    borrowers = [object() for _ in range(int(threads.total_tokens))]
    for borrower in borrowers:
        client.portal.call(threads.acquire_on_behalf_of, borrower)
    with ThreadPoolExecutor(1) as pool:
        asked = pool.submit(client.get, "/readyz")
        answered, _ = wait([asked], 60)
        for borrower in borrowers:
            client.portal.call(threads.release_on_behalf_of, borrower)
    assert answered
    assert asked.result().status_code == 200


def test_not_ready_before_the_model_is_loaded(settings: Settings, tmp_path: Path) -> None:
    """Without a lifespan nothing is loaded: the process lives, the work is refused with Retry-After."""
    idle = TestClient(create_app(settings.model_copy(update={"store": tmp_path})), raise_server_exceptions=False)
    assert idle.get("/healthz").status_code == 200
    assert_problem(idle.get("/readyz"), 503, "model_not_ready")
    for answer in (idle.get("/render"), post(idle)):
        assert_problem(answer, 503, "model_not_ready")
        assert int(answer.headers["retry-after"]) > 0
    assert idle.get("/scenes").json() == {"scenes": [], "next": None}


@pytest.mark.parametrize("content", [None, b"no model"])
def test_model_that_cannot_be_loaded(tmp_path: Path, content: bytes | None, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "model.onnx"
    if content is not None:
        path.write_bytes(content)
    app = create_app(Settings(model=path, store=tmp_path / "scenes"))
    with TestClient(app, raise_server_exceptions=False) as client:
        deadline = time.monotonic() + 300
        while (body := client.get("/readyz").json())["state"] == "starting":
            assert time.monotonic() < deadline
            time.sleep(0.05)
        assert body["state"] == "failed"
        assert body["code"] == "model_not_ready"
        assert "'model'" in body["detail"]  # the stage; path and reason are for the log
        assert str(tmp_path) not in client.get("/readyz").text
        assert str(path) in caplog.text
        assert client.get("/healthz").status_code == 200


def test_page_loads_nothing_from_elsewhere(client: TestClient) -> None:
    page = client.get("/")
    assert page.headers["content-type"].startswith("text/html")
    policy = dict(part.strip().split(" ", 1) for part in page.headers["content-security-policy"].split(";"))
    assert policy["default-src"] == "'none'"
    assert policy["script-src"] == policy["style-src"] == "'self'"
    sources = re.findall(r'(?:src|href|action)="([^"#][^"]*|)"', page.text)  # all but places of the page itself
    assert sources
    assert all(source.startswith("/") and not source.startswith("//") for source in sources)
    assert not re.search(r"<script[^>]*>[^<]|\son\w+=|style=", page.text), "inline code that the policy forbids"
    for source in sources:
        if source.startswith("/static/"):
            answer = client.get(source)
            assert answer.status_code == 200
            assert "https://" not in answer.text


def test_elements_that_the_scripts_use_are_in_the_page_once(client: TestClient) -> None:
    scripts = [path.read_text(encoding="utf-8") for path in (STATIC / "js").glob("*.js")]
    used = {name for text in scripts for name in re.findall(r'\$\("([\w-]+)"\)', text)}
    made = [name for text in scripts for name in re.findall(r'\bid: "([\w-]+)"', text)]
    there = re.findall(r'id="([\w-]+)"', client.get("/").text) + made
    assert len(used) > 20
    assert used <= set(there)
    assert len(there) == len(set(there))


def test_scripts_import_nothing_from_elsewhere() -> None:
    for path in (STATIC / "js").glob("*.js"):
        text = path.read_text(encoding="utf-8")
        for source in re.findall(r'^import .* from "([^"]*)"', text, re.MULTILINE):
            assert source.startswith(("./", "/static/")), (path.name, source)
        assert not re.search(r"innerHTML|\beval\(|https?://(?!www\.w3\.org/2000/svg)", text), path.name


def test_the_frame_of_the_viewer_lies_in_this_page_alone(client: TestClient) -> None:
    """Its policy lets WebAssembly and its own worker run, and no inline script; no viewer, no frame."""
    answer = client.get("/viewer")
    if not (STATIC / VIEWER).is_file():
        assert_problem(answer, 404, "route_not_found")
        return
    policy = dict(part.strip().split(" ", 1) for part in answer.headers["content-security-policy"].split(";"))
    assert policy["script-src"] == "'self' 'wasm-unsafe-eval' blob:"
    assert policy["frame-ancestors"] == "'self'"
    assert not re.search(r"<script[^>]*>[^<]", answer.text)


def test_the_documentation_runs_no_script_but_those_of_the_package(client: TestClient) -> None:
    answer = client.get("/docs")
    policy = dict(part.strip().split(" ", 1) for part in answer.headers["content-security-policy"].split(";"))
    assert (policy["default-src"], policy["script-src"], policy["connect-src"]) == ("'none'", "'self'", "'self'")
    assert policy["frame-ancestors"] == "'none'"
    assert not re.search(r"<script[^>]*>[^<]", answer.text)
    for path in re.findall(r'(?:src|href)="(/static/[^"]*)"', answer.text):
        assert client.get(path).status_code == 200, path


def test_static_files_are_packed_and_kept(client: TestClient) -> None:
    path = "/static/js/stage.js"
    packed, plain = (client.get(path, headers={"Accept-Encoding": kind}) for kind in ("gzip", "identity"))
    assert packed.headers["content-encoding"] == "gzip"
    assert "content-encoding" not in plain.headers
    assert packed.content == plain.content  # the client unpacks it
    kept = client.get(path, headers={"If-None-Match": plain.headers["etag"]})
    assert kept.status_code == 304
    assert kept.content == b""


@pytest.mark.parametrize("name", ["nothing.js", "..%2fapp.py", "index.html%00", "__init__.py"])
def test_no_other_file_is_served(client: TestClient, name: str) -> None:
    assert_problem(client.get(f"/static/{name}"), 404, "route_not_found")


@pytest.mark.parametrize(
    ("method", "path", "status", "code"),
    [
        ("GET", "/nowhere", 404, "route_not_found"),
        ("GET", "/docs/", 404, "route_not_found"),
        ("GET", "/reconstruct", 405, "method_not_allowed"),
        ("POST", "/render", 405, "method_not_allowed"),
        ("PUT", "/scenes", 405, "method_not_allowed"),
        ("PATCH", "/scenes/abc", 405, "method_not_allowed"),
        ("DELETE", "/", 405, "method_not_allowed"),
    ],
)
def test_framework_errors_are_problems(client: TestClient, method: str, path: str, status: int, code: str) -> None:
    answer = client.request(method, path)
    assert_problem(answer, status, code)
    if status == 405:
        assert answer.headers["allow"]


@pytest.mark.parametrize("path", ["/", "/scenes", "/models", "/healthz", "/readyz"])
def test_monitors_may_ask_for_the_head_alone(client: TestClient, path: str) -> None:
    head, whole = client.head(path), client.get(path)
    assert (head.status_code, head.headers["content-type"]) == (200, whole.headers["content-type"])


def test_unexpected_exception_is_a_problem_without_internals(
    client: TestClient, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("secret")

    with monkeypatch.context() as patch:
        patch.setattr(Reconstructor, "reconstruct", broken)
        answer = post(client, [photograph(50), photograph(51)])
    body = assert_problem(answer, 500, "internal_error")
    assert "secret" not in answer.text
    assert "ZeroDivisionError" in body["detail"]
    assert "secret" in caplog.text
    again = post(client, [photograph(50), photograph(51)])
    assert again.status_code == 201
    client.delete(again.headers["location"])


def test_a_model_that_fails_tells_the_log_and_not_the_client(
    client: TestClient, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ModelError("/srv/models/own.onnx: Non-zero status code in onnxruntime", field="model")

    with monkeypatch.context() as patch:
        patch.setattr(Engine, "run", broken)
        answer = post(client, [photograph(52), photograph(53)])
    assert_problem(answer, 500, "model_invalid")
    assert "srv" not in answer.text
    assert "onnxruntime" not in answer.text
    assert "/srv/models/own.onnx" in caplog.text


def test_a_full_queue_refuses_with_retry_after(settings: Settings, tmp_path: Path) -> None:
    full = create_app(settings.model_copy(update={"store": tmp_path, "max_waiting": 0, "render_waiting": 0}))
    with TestClient(full, raise_server_exceptions=False) as client:
        wait_until_ready(client)
        runtime = full.state.runtime
        assert post(client).status_code == 201
        for held, name, full_at, ask in (  # a slot is free, which is a place, too
            (runtime.jobs.table, "_most", -1, lambda: post(client, [photograph(5), photograph(6)])),
            (runtime.pictures.limit, "most", 0, lambda: client.get("/render?view=0")),
        ):
            before = getattr(held, name)
            setattr(held, name, full_at)
            answer = ask()
            assert_problem(answer, 503, "service_busy")
            assert int(answer.headers["retry-after"]) > 0
            setattr(held, name, before)
            assert ask().status_code in (200, 201)


def test_openapi_lists_the_routes(client: TestClient) -> None:
    document = client.get("/openapi.json").json()
    assert {"/reconstruct", "/render", "/scenes", "/healthz", "/readyz"} <= set(document["paths"])
    used = {tag for methods in document["paths"].values() for one in methods.values() for tag in one["tags"]}
    assert used == {tag["name"] for tag in document["tags"]}
    schema = document["paths"]["/reconstruct"]["post"]["requestBody"]["content"]["multipart/form-data"]["schema"]
    assert [set(way["required"]) for way in schema["anyOf"]] == [{"images", "cameras"}, {"capture"}]


def test_import_loads_nothing_heavy() -> None:
    code = """if True:
        import sys, gapmes.service.app, gapmes.service.cli
        heavy = ("torch", "numba", "onnxruntime", "gapmes.model", "gapmes.export")
        print([name for name in heavy if name in sys.modules])
    """
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
