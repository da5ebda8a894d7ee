"""The health check: the address that it asks, and that a service without an answer is not ready."""

from __future__ import annotations

import socket

import pytest

from gapmes.service.probe import address, ready


@pytest.mark.parametrize(
    ("host", "asked"),
    [
        ("127.0.0.1", "http://127.0.0.1:80"),
        ("0.0.0.0", "http://127.0.0.1:80"),
        ("::", "http://[::1]:80"),
        ("::1", "http://[::1]:80"),
        ("10.1.2.3", "http://10.1.2.3:80"),
    ],
)
def test_it_asks_where_the_service_listens(host: str, asked: str) -> None:
    assert address(host, "80") == asked


@pytest.mark.parametrize("host", ["127.0.0.1", "no host"])
def test_where_nobody_answers_nothing_is_ready(host: str) -> None:
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))  # and does not listen
        assert not ready(host, str(bound.getsockname()[1]))
