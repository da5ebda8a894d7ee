"""docs/http.md names every error code, route and parameter, and its example of a scene document is like a real one."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from http_requests import camera_object, photograph, post
from starlette.testclient import TestClient

from gapmes.service import errors
from gapmes.service.http.preview import PreviewQuery, SheetQuery
from gapmes.service.http.problems import FRAMEWORK_CODES
from gapmes.service.http.render import RenderQuery
from gapmes.service.http.upload import FIELDS

TEXT = (Path(__file__).parents[3] / "docs" / "http.md").read_text(encoding="utf-8")


def documented_codes() -> dict[str, int]:
    rows = re.findall(r"^\| (\d{3}) \| (.*?) \|", TEXT, re.MULTILINE)
    return {code: int(status) for status, codes in rows for code in re.findall(r"`(\w+)`", codes)}


def test_every_code_is_documented() -> None:
    classes = [value for value in vars(errors).values() if isinstance(value, type)]
    expected = {value.code: value.status for value in classes if issubclass(value, errors.GapmesError)}
    expected |= {code: status for status, code in FRAMEWORK_CODES.items()}
    expected |= {"parameter_invalid": 422, "client_disconnected": 400}
    expected |= {"job_abandoned": 500, "range_not_satisfiable": 416}
    assert documented_codes() == expected


def test_every_route_and_parameter_is_documented(client: TestClient) -> None:
    for path, methods in client.get("/openapi.json").json()["paths"].items():
        shown = re.sub(r"\{(scene|job)_id\}", "{id}", path)
        for method in methods:
            assert re.search(rf"`{method.upper()} {re.escape(shown)}`", TEXT), (method, path)
    for name in (*RenderQuery.model_fields, *PreviewQuery.model_fields, *SheetQuery.model_fields, *FIELDS):
        assert f"`{name}`" in TEXT, name


def test_example_of_a_scene_document_has_the_keys_of_a_real_one(client: TestClient) -> None:
    (text,) = (block for block in re.findall(r"```json\n(.*?)```", TEXT, re.DOTALL) if '"gaussians"' in block)
    cameras = camera_object(2)
    for view, name in zip(cameras["views"], ("a.png", "b.png"), strict=True):
        view["image"] = name
    answer = post(client, [photograph(70), photograph(71)], cameras, names=["000.png", "004.png"], views="0")
    example, real = json.loads(text), answer.json()
    client.delete(answer.headers["location"])
    assert_same_keys(example, real, "")
    for name in ("paired_by", "depth_range_source", "images"):
        assert example[name] == real[name]
    assert example["model"]["precision"] == real["model"]["precision"]
    assert example["warnings"][0]["code"] == real["warnings"][0]["code"]


def assert_same_keys(example: Any, real: Any, path: str) -> None:
    """Objects have the same members all the way down; lists are compared by their first entries."""
    if isinstance(example, dict) and path != ".routing.patches_per_expert":  # its members are the experts' numbers
        assert set(example) == set(real), path
        for name, value in example.items():
            assert_same_keys(value, real[name], f"{path}.{name}")
    elif isinstance(example, list) and example and real:
        assert_same_keys(example[0], real[0], f"{path}[0]")


def test_a_document_with_other_keys_is_noticed() -> None:
    with pytest.raises(AssertionError, match=r"\.crop\[0\]"):
        assert_same_keys({"crop": [{"kept_share": 1, "scale": 2}]}, {"crop": [{"kept_share": 1}]}, "")


def test_every_metric_is_documented(client: TestClient) -> None:
    page = (Path(__file__).parents[3] / "docs" / "operations.md").read_text(encoding="utf-8")
    documented = {name for name in re.findall(r"`(gapmes_\w+)`", page)}
    text = client.get("/metrics").text
    kinds = dict(re.findall(r"^# TYPE (gapmes_\w+) (\w+)$", text, re.MULTILINE))
    assert documented == set(kinds)
    assert set(kinds.values()) <= {"counter", "histogram", "gauge"}
