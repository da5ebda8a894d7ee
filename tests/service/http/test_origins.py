"""Pages of other origins cannot change anything: their requests are refused; the service's own, and those without a
browser, pass."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from http_requests import assert_problem, wait_until_ready
from starlette.testclient import TestClient

from gapmes.service.app import create_app
from gapmes.service.settings import Settings

SCENE = f"/scenes/{'0' * 32}"  # which there is none of: a request that passes is answered by 404


@pytest.fixture(scope="module")
def told(settings: Settings, tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    """A service that knows other origins."""
    changed = {
        "store": tmp_path_factory.mktemp("told") / "scenes",
        "cors_origins": "https://one.example, https://two.example:8443",
    }
    with TestClient(create_app(settings.model_copy(update=changed)), raise_server_exceptions=False) as client:
        wait_until_ready(client)
        yield client


FOREIGN = [
    {"Origin": "https://other.example"},
    {"Origin": "http://testserver:81"},
    {"Origin": "http://testserver.other.example"},
    {"Origin": "http://testserver", "Sec-Fetch-Site": "cross-site"},
    {"Origin": "http://testserver:81", "Sec-Fetch-Site": "same-site"},
    {"Origin": "null", "Sec-Fetch-Site": "cross-site"},
    {"Origin": "null", "Sec-Fetch-Site": "same-site"},
    {"Origin": "null"},  # a sandboxed frame or a file
    {"Sec-Fetch-Site": "cross-site"},
    {"Origin": "http://[testserver"},
    {"Origin": "http://testserver:port"},
    {"Origin": ""},
    {"Origin": "x" * 5000},
]


@pytest.mark.parametrize("headers", FOREIGN)
@pytest.mark.parametrize(
    ("method", "path"),
    [("POST", "/reconstruct"), ("POST", "/check"), ("POST", "/scenes"), ("DELETE", SCENE), ("DELETE", "/jobs/x")],
)
def test_pages_of_other_origins_are_refused(
    client: TestClient, told: TestClient, headers: dict[str, str], method: str, path: str
) -> None:
    """Also by a service that knows some, before anything of the body is looked at."""
    for service in (client, told):
        answer = service.request(method, path, headers=headers)
        body = assert_problem(answer, 403, "origin_refused", "Origin", cured=True)
        assert "GAPMES_CORS_ORIGINS" in body["cure"]
        assert len(body["detail"]) < 200
        assert "access-control-allow-origin" not in answer.headers


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"Origin": "null", "Sec-Fetch-Site": "same-origin"},
        {"Origin": "http://testserver"},
        {"Origin": "HTTP://TestServer:80"},
        {"Origin": "https://testserver"},  # a proxy with TLS stands before it
        {"Origin": "https://gapmes.example", "Host": "gapmes.example:443"},
        {"Origin": "http://gapmes.example:8000", "Host": "gapmes.example:8000"},
        {"Origin": "http://[::1]:8000", "Host": "[::1]:8000"},
        {"Origin": "https://gapmes.example", "Host": "service:8000", "Sec-Fetch-Site": "same-origin"},  # a proxy's Host
        {"Sec-Fetch-Site": "none"},
    ],
)
def test_the_services_own_page_and_what_is_no_browser_pass(
    client: TestClient, told: TestClient, headers: dict[str, str]
) -> None:
    for service in (client, told):
        assert_problem(service.delete(SCENE, headers=headers), 404, "scene_not_found")


@pytest.mark.parametrize("origin", ["https://one.example", "https://two.example:8443"])
@pytest.mark.parametrize("site", ["cross-site", "same-site", None])
def test_origins_that_the_service_knows_pass(told: TestClient, origin: str, site: str | None) -> None:
    headers = {"Origin": origin} | ({} if site is None else {"Sec-Fetch-Site": site})
    answer = told.delete(SCENE, headers=headers)
    assert_problem(answer, 404, "scene_not_found")
    assert answer.headers["access-control-allow-origin"] == origin


def test_all_origins_pass_where_all_may_call(settings: Settings) -> None:
    app = create_app(settings.model_copy(update={"cors_origins": "*"}))
    client = TestClient(app, raise_server_exceptions=False)
    for headers in FOREIGN:
        assert_problem(client.delete(SCENE, headers=headers), 404, "scene_not_found")


@pytest.mark.parametrize("headers", FOREIGN)
def test_reading_is_the_browsers_to_forbid(client: TestClient, headers: dict[str, str]) -> None:
    """It keeps the answer from the page, and there is no effect."""
    for method in ("GET", "HEAD"):
        answer = client.request(method, "/scenes", headers=headers)
        assert answer.status_code == 200
        assert "access-control-allow-origin" not in answer.headers
