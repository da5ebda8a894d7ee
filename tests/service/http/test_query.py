"""Queries: each parameter once, none together with a form, and checked without a thread."""

from __future__ import annotations

from collections.abc import Iterable

import anyio.to_thread
import pytest
from http_requests import assert_problem
from starlette.testclient import TestClient


@pytest.mark.parametrize(
    ("path", "field"),
    [("/render?view=0&view=2", "view"), ("/scenes?limit=1&after=&limit=1", "limit"), ("/healthz?a=1&a=2", "a")],
)
def test_a_parameter_is_given_once(client: TestClient, path: str, field: str) -> None:
    body = assert_problem(client.get(path), 422, "parameter_invalid", field)
    assert "2 times, need it once" in body["detail"]


@pytest.mark.parametrize("path", ["/healthz", "/scenes", "/jobs/x"])
@pytest.mark.parametrize("names", [range(65), [*range(33), *range(33)]])
def test_thousands_of_parameters_are_not_compared_with_each_other(
    client: TestClient, path: str, names: Iterable[int]
) -> None:
    """The answer would list each, and the search for all values of each take time with the square of their number: a
    second for 20 kB, on the thread that answers everybody, without a key."""
    query = "&".join(f"a{name}" for name in names)
    body = assert_problem(client.get(f"{path}?{query}"), 422, "invalid_input", "query", cured=True)
    assert body["detail"] == f"{query.count('&') + 1} parameters, need at most 64"


def test_as_many_parameters_as_are_allowed_are_told_one_by_one(client: TestClient) -> None:
    query = "&".join(f"a{name}" for name in range(64))
    body = assert_problem(client.get(f"/scenes?{query}"), 422, "parameter_invalid", "a0")
    assert len(body["errors"]) == 64


@pytest.mark.parametrize("number", ["1_0", "0_0", "%2B0", "%D9%A0", ""])
def test_a_whole_number_is_decimal_digits(client: TestClient, number: str) -> None:
    """Python itself accepts more forms."""
    job = f"/jobs/{'0' * 32}/events?after={number}"
    assert_problem(client.get(job), 422, "parameter_invalid", "after")
    if number:
        assert_problem(client.get(f"/scenes/{'0' * 32}/inputs/{number}"), 422, "parameter_invalid", "index")


@pytest.mark.parametrize("number", ["5.0", "%205", "%2B5", "1_0", "5e0", "%D9%A5", ""])
@pytest.mark.parametrize(("path", "field"), [("/scenes", "limit"), ("/render", "width"), ("/render", "sh_degree")])
def test_a_whole_number_of_a_query_is_decimal_digits_as_in_a_form(
    client: TestClient, path: str, field: str, number: str
) -> None:
    body = assert_problem(client.get(f"{path}?{field}={number}"), 422, "parameter_invalid", field)
    assert "whole number in decimal digits" in body["detail"]
    assert "greater than" in client.get(f"{path}?{field}=-5").json()["detail"]


def test_events_have_no_other_parameters(client: TestClient) -> None:
    """A misspelt one would send all events again."""
    answer = client.get(f"/jobs/{'0' * 32}/events?last=5")
    problem = assert_problem(answer, 422, "parameter_invalid", "last", cured=True)
    assert problem["cure"] == "parameters: after, lastEventId"


@pytest.mark.parametrize("route", ["/reconstruct", "/check", "/scenes"])
def test_options_of_a_form_are_not_in_the_query(client: TestClient, route: str) -> None:
    """They would be ignored there."""
    answer = client.post(f"{route}?near=2", files={"file": ("a.ply", b"ply")})
    body = assert_problem(answer, 422, "invalid_input", "near", cured=True)
    assert body["detail"] == "is in the query beside a form"


def test_a_probe_needs_no_thread(client: TestClient) -> None:
    """While all of the pool's are busy, on a slow disk say, the process is alive all the same."""
    assert client.portal is not None
    limiter = client.portal.call(anyio.to_thread.current_default_thread_limiter)
    borrowers = [object() for _ in range(int(limiter.total_tokens))]
    for borrower in borrowers:
        client.portal.call(limiter.acquire_on_behalf_of, borrower)
    try:
        assert client.get("/healthz").status_code == 200
    finally:
        for borrower in borrowers:
            client.portal.call(limiter.release_on_behalf_of, borrower)
