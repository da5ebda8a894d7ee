"""With a list of its names the service answers by no other, so that a name that leads to it makes no page its own."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from http_requests import assert_problem, wait_until_ready
from starlette.testclient import TestClient

from gapmes.service.app import create_app
from gapmes.service.settings import Settings

LISTED = "gapmes.example, Localhost,[::1]"


@pytest.fixture(scope="module")
def named(settings: Settings, tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    changed = {"store": tmp_path_factory.mktemp("named") / "scenes", "allowed_hosts": LISTED}
    with TestClient(create_app(settings.model_copy(update=changed)), raise_server_exceptions=False) as client:
        wait_until_ready(client)
        yield client


@pytest.mark.parametrize("host", ["gapmes.example", "GAPMES.example:8443", "localhost:8000", "[::1]", "[::1]:8000"])
@pytest.mark.parametrize("path", ["/", "/scenes", "/docs", "/static/page.css"])
def test_names_of_the_list_are_answered(named: TestClient, host: str, path: str) -> None:
    assert named.get(path, headers={"Host": host}).status_code == 200


@pytest.mark.parametrize(
    "host",
    ["other.example", "gapmes.example.other.example", "x.gapmes.example", "127.0.0.1:8000", "", "::1",
     "gapmes.example:x", "user@gapmes.example", "gapmes.example/", "gapmes.example#", "x" * 5000],
)  # fmt: skip
@pytest.mark.parametrize(
    ("method", "path"),
    [("GET", "/"), ("GET", "/scenes"), ("POST", "/reconstruct"), ("GET", "/metrics"), ("GET", "/no")],
)
def test_other_names_are_refused(named: TestClient, client: TestClient, host: str, method: str, path: str) -> None:
    body = assert_problem(named.request(method, path, headers={"Host": host}), 421, "host_refused", "Host", cured=True)
    assert "GAPMES_ALLOWED_HOSTS" in body["cure"]
    assert len(body["detail"]) < 200
    assert client.request(method, path, headers={"Host": host}).status_code != 421  # without a list all are its own


@pytest.mark.parametrize("path", ["/healthz", "/readyz"])
def test_probes_ask_by_any_address(named: TestClient, path: str) -> None:
    assert named.get(path, headers={"Host": "10.1.2.3:8000"}).status_code == 200
