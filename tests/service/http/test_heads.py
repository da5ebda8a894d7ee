"""Request heads that HTTP/1.1 allows: absolute targets, two lengths, lists in several lines."""

from __future__ import annotations

import gzip
import http.client
from collections.abc import Iterator
from pathlib import Path

import pytest
from http_requests import MAX_UPLOAD, assert_problem, photograph, post
from served_process import serving
from starlette.testclient import TestClient

from gapmes.service.app import EXPOSED
from gapmes.service.http.limits import CURES, SETTING


@pytest.fixture(scope="module")
def address(standin_model: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    folder = tmp_path_factory.mktemp("heads")
    with serving(folder / "scenes", standin_model, folder / "log") as (client, _):
        yield f"{client.base_url.host}:{client.base_url.port}"


@pytest.mark.parametrize(
    ("target", "status"),
    [
        ("http://{}/healthz", 200),
        ("HTTP://{}/scenes?limit=1", 200),
        ("http://{}", 200),
        ("http://somebody@other.example/healthz", 200),
        ("http:///healthz", 404),
        ("http://{}/no%20where", 404),
    ],
)
def test_a_target_in_absolute_form_is_the_path_in_it(address: str, target: str, status: int) -> None:
    connection = http.client.HTTPConnection(address, timeout=120)
    connection.request("GET", target.format(address))
    assert connection.getresponse().status == status
    connection.close()


def test_the_host_of_an_absolute_target_is_the_one_that_counts(address: str) -> None:
    """The page that asks is that of this host, whatever the header says."""
    connection = http.client.HTTPConnection(address, timeout=120)
    headers = {"Host": "other.example", "Origin": f"http://{address}"}
    for target, status in ((f"http://{address}/scenes/0", 404), ("/scenes/0", 403)):
        connection.request("DELETE", target, headers=headers)
        answer = connection.getresponse()
        answer.read()
        assert answer.status == status
    connection.close()


def test_a_body_of_two_lengths_is_refused(address: str) -> None:
    connection = http.client.HTTPConnection(address, timeout=120)
    headers = {"Content-Length": "11", "Transfer-Encoding": "chunked"}
    connection.request("POST", "/check", b"1\r\na\r\n0\r\n\r\n", headers)
    answer = connection.getresponse()
    assert answer.status == 400
    assert answer.headers["X-Gapmes-Problem"] == "malformed_request"
    assert answer.headers["Connection"] == "close"
    connection.close()


def test_a_list_may_come_in_several_lines(client: TestClient) -> None:
    link = post(client).json()["links"]["ply"]
    etag = client.get(link).headers["etag"]
    assert client.get(link, headers=[("If-None-Match", '"x"'), ("If-None-Match", etag)]).status_code == 304
    parts = [("images", (f"{k}.png", photograph(k))) for k in range(2)]
    lines = [("Accept", "text/html"), ("Accept", "application/octet-stream;q=0")]
    assert_problem(client.post("/reconstruct", files=parts, headers=lines), 406, "not_acceptable", "Accept")
    lines[1] = ("Accept", "application/json")
    assert_problem(client.post("/reconstruct", files=parts, headers=lines), 422, "invalid_input", "cameras")


@pytest.mark.parametrize(
    ("lines", "packed"),
    [
        (["gzip"], True),
        (["GZIP"], True),
        (["br, *"], True),
        (["br", "x-gzip;q=0.1"], True),
        ([""], False),
        (["identity"], False),
        (["notgzip"], False),
        (["gzip;q=0"], False),
        (["gzip;q=0, *"], False),
        (["*;q=0"], False),
    ],
)
def test_files_are_packed_for_those_who_take_that(client: TestClient, lines: list[str], packed: bool) -> None:
    answer = client.get("/static/js/stage.js", headers=[("Accept-Encoding", line) for line in lines])
    assert ("content-encoding" in answer.headers) == packed
    assert answer.headers["vary"] == "Accept-Encoding"
    kept = client.get("/static/js/stage.js", headers={"If-None-Match": answer.headers["etag"]})
    assert (kept.status_code, kept.headers["vary"]) == (304, "Accept-Encoding")


@pytest.mark.parametrize("asked", ["BYTES=0-9", "bytes=,0-9", "bytes=0-9 ,", "bytes= , ,0-9,,"])
def test_a_range_in_other_words_is_one(client: TestClient, asked: str) -> None:
    link = post(client).json()["links"]["ply"]
    answer = client.get(link, headers={"Range": asked})
    assert (answer.status_code, answer.content) == (206, client.get(link).content[:10])


@pytest.mark.parametrize("asked", ["bytes=", "bytes=,", "bytes=0-9 10-12", "lines=0-9"])
def test_what_is_no_range_is_passed_over(client: TestClient, asked: str) -> None:
    link = post(client).json()["links"]["ply"]
    assert client.get(link, headers={"Range": asked}).status_code == 200


def test_scripts_of_other_origins_may_read_what_answers_say() -> None:
    assert {"Content-Range", "Accept-Ranges", "Content-Disposition", "X-Gapmes-Problem"} <= set(EXPOSED)


@pytest.mark.parametrize("path", ["/reconstruct", "/check", "/scenes", "/nowhere"])
def test_a_body_that_is_too_large_is_told_what_fits_its_route(client: TestClient, path: str) -> None:
    answer = client.post(path, content=bytes(MAX_UPLOAD + 1), headers={"Content-Type": "application/octet-stream"})
    cure = assert_problem(answer, 413, "upload_too_large", "body")["cure"]
    assert cure == CURES.get(path, f"send less, or raise {SETTING}")
    assert SETTING in cure
    assert ("photographs" in cure) == (path in ("/reconstruct", "/check"))
    assert (".spz" in cure) == (path == "/scenes")


def test_a_long_name_of_a_file_is_named_as_what_is_wrong(client: TestClient) -> None:
    from python_multipart import multipart

    most = getattr(multipart, "DEFAULT_MAX_HEADER_SIZE", None)  # earlier releases have no bound
    for path in ("/reconstruct", "/scenes") if most else ():
        field = "images" if path == "/reconstruct" else "file"
        answer = client.post(path, files=[(field, ("a" * (most or 0), gzip.compress(b"")))])
        problem = assert_problem(answer, 400, "malformed_request", "body")
        assert problem["detail"].startswith("a part of the form has too long or too many headers: Maximum header size")
        assert problem["cure"].startswith("shorten the file's name")
