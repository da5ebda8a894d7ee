"""The service's own small parts by themselves: the gate, Accept, JSON parsing, problem documents."""

from __future__ import annotations

import asyncio
import json

import numpy as np
import pytest

from gapmes.service.errors import InputError, MalformedRequest, NotAcceptable, ServiceBusy
from gapmes.service.http.gate import Gate
from gapmes.service.http.limits import parse_json
from gapmes.service.http.responses import JSON, PLY, ZIP, accepted
from gapmes.service.problem_document import of_error


def test_gate_admits_as_many_as_it_says() -> None:
    async def scenario() -> None:
        gate = Gate(slots=1, waiting=1)
        async with gate.admitted(), gate.admitted():
            with pytest.raises(ServiceBusy):
                async with gate.admitted():
                    pass
        async with gate.admitted():
            pass

    asyncio.run(scenario())


def test_gate_lets_one_in_per_key_and_forgets_the_key() -> None:
    inside: list[str] = []

    async def task(gate: Gate, key: str) -> None:
        async with gate.alone(key):
            assert key not in inside
            inside.append(key)
            await asyncio.sleep(0.001)
            inside.remove(key)

    async def scenario() -> None:
        gate = Gate(slots=4, waiting=4)
        await asyncio.gather(*(task(gate, key) for key in "aabbabba"))
        assert not gate._locks

    asyncio.run(scenario())


def test_gate_survives_a_failure_inside() -> None:
    async def scenario() -> None:
        gate = Gate(slots=1, waiting=0)
        for _ in range(3):
            with pytest.raises(ZeroDivisionError):
                async with gate.admitted(), gate.alone("a"):
                    await gate.run(lambda: 1 / 0)
        assert not gate._locks
        assert await gate.run(lambda: 7) == 7

    asyncio.run(scenario())


@pytest.mark.parametrize(
    ("header", "kind"),
    [
        (None, JSON),
        ("", JSON),
        ("*/*", JSON),
        ("application/zip", ZIP),
        ("APPLICATION/ZIP", ZIP),
        ("application/octet-stream", PLY),
        ("application/json;q=0, */*", PLY),
        ("application/zip;q=0.9, application/json;q=0.8", ZIP),
        ("text/html, */*;q=0.1", JSON),
    ],
)
def test_accepted(header: str | None, kind: str) -> None:
    assert accepted(header) == kind


@pytest.mark.parametrize("header", ["text/html", "*/*;q=0", "application/json;q=nan", "application/json;q=x"])
def test_not_accepted(header: str) -> None:
    with pytest.raises(NotAcceptable):
        accepted(header)


def test_json_numbers_never_overflow_later() -> None:
    assert parse_json("123456789012345", "x") == 123456789012345
    assert parse_json("1" + "0" * 400, "x") == float("inf")
    assert parse_json("-1" + "0" * 5000, "x") == float("-inf")
    assert np.isnan(parse_json("NaN", "x"))


@pytest.mark.parametrize("text", [b"\xff\xfe", b"{", b"", b"[" * 1_000_000])
def test_json_that_is_none(text: bytes) -> None:
    with pytest.raises(MalformedRequest):
        parse_json(text, "x")


def test_problem_document_is_always_json() -> None:
    error = InputError("no", field="x", extra_array=np.arange(2), nan=float("nan"), status="kept out", odd=object())
    document = of_error(error)
    json.dumps(document, allow_nan=False)
    assert document["status"] == 422
    assert document["extra_array"] == [0, 1]
    assert document["nan"] == "nan"
    assert "index" not in document
