"""docs/errors.md names every error and warning code, docs/http.md every route and parameter, and the example scene of
docs/scene-document.md resembles a real one; docs/operations.md names every metric and everything in a store."""

from __future__ import annotations

import ast
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
from gapmes.service.pictures.effort import LIMITS
from gapmes.service.scenes.scene_files import is_id
from gapmes.service.settings import Settings

ROOT = Path(__file__).parents[3]
TEXT, ERRORS, SCENE, OPERATIONS = (
    (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    for name in ("http", "errors", "scene-document", "operations")
)


def documented_codes() -> dict[str, int]:
    """In the order of the table."""
    rows = re.findall(r"^\| (\d{3}) \| (.*?) \|", ERRORS, re.MULTILINE)
    return {code: int(status) for status, codes in rows for code in re.findall(r"`(\w+)`", codes)}


def warning_codes() -> set[str]:
    """Of every object with a code and a message that the sources of the service write."""
    found = set()
    for path in (ROOT / "service").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Dict):
                members = {
                    key.value: value for key, value in zip(node.keys, node.values, strict=True)
                    if isinstance(key, ast.Constant)
                }  # fmt: skip
                if {"code", "message"} <= set(members):
                    found.add(ast.literal_eval(members["code"]))
    return found


def test_every_code_is_documented() -> None:
    classes = [value for value in vars(errors).values() if isinstance(value, type)]
    expected = {value.code: value.status for value in classes if issubclass(value, errors.GapmesError)}
    expected |= {code: status for status, code in FRAMEWORK_CODES.items()}
    expected |= {"parameter_invalid": 422, "client_disconnected": 400}
    expected |= {"job_abandoned": 500, "range_not_satisfiable": 416}
    assert documented_codes() == expected
    assert list(documented_codes().values()) == sorted(expected.values())


def test_every_warning_is_documented() -> None:
    table = ERRORS.partition("## Warnings")[2]
    assert set(re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)) == warning_codes()
    assert "names_differ" in warning_codes()


def test_every_route_and_parameter_is_documented(client: TestClient) -> None:
    for path, methods in client.get("/openapi.json").json()["paths"].items():
        shown = re.sub(r"\{(scene|job)_id\}", "{id}", path)
        for method in set(methods) - {"head"}:  # of which one sentence says that it is answered wherever GET is
            assert re.search(rf"`{method.upper()} {re.escape(shown)}`", TEXT), (method, path)
    for name in (*RenderQuery.model_fields, *PreviewQuery.model_fields, *SheetQuery.model_fields, *FIELDS):
        assert f"`{name}`" in TEXT, name


def test_bounds_of_pictures_are_documented() -> None:
    (widest,) = [bound.le for bound in RenderQuery.model_fields["width"].metadata if hasattr(bound, "le")]
    assert f"at most {widest:,} px" in TEXT
    knobs = (ROOT / "docs" / "splatting.md").read_text(encoding="utf-8")
    for name, row in (("alpha_min", "alpha_min"), ("stop", "alpha_min"), ("cut_radius", "cut_radius")):
        low, high = (f"{bound:g}".replace("e-0", "e-") for bound in LIMITS[name])
        assert f"{low} to {high}" in next(line for line in TEXT.splitlines() if line.startswith(f"| `{row}`"))
        assert f"`{name}` from {low} to {high}" in knobs


def test_example_of_a_scene_document_has_the_keys_of_a_real_one(client: TestClient) -> None:
    (text,) = (block for block in re.findall(r"```json\n(.*?)```", SCENE, re.DOTALL) if '"gaussians"' in block)
    cameras = camera_object(2)
    names = ["000.png", "004.png"]
    for view, name in zip(cameras["views"], names, strict=True):
        view["image"] = name
    answer = post(client, [photograph(70), photograph(71)], cameras, names=names, views="0")
    example, real = json.loads(text), answer.json()
    client.delete(answer.headers["location"])
    assert_same_keys(example, real, "")
    for name in ("paired_by", "depth_range_source", "images"):
        assert example[name] == real[name]
    assert example["model"]["precision"] == real["model"]["precision"]
    assert example["warnings"] == []
    assert "names_differ" not in [warning["code"] for warning in real["warnings"]]


def assert_same_keys(example: Any, real: Any, path: str) -> None:
    """Objects have the same members all the way down; lists are compared by their first entries."""
    if isinstance(example, dict) and path != ".routing.patches_per_expert":  # its members are the experts' numbers
        assert set(example) == set(real), path
        for name, value in example.items():
            assert_same_keys(value, real[name], f"{path}.{name}")
    elif isinstance(example, list) and example and real:
        assert_same_keys(example[0], real[0], f"{path}[0]")


def test_numbers_of_the_example_add_up() -> None:
    (text,) = (block for block in re.findall(r"```json\n(.*?)```", SCENE, re.DOTALL) if '"gaussians"' in block)
    example = json.loads(text)
    pruned, rows = example["pruning"], [row for row in example["left_out"] if row["what"].startswith("Gaussians")]
    assert example["gaussians"]["count"] == pruned["kept"]
    assert sum(row["count"] for row in example["dropped"]) + pruned["dropped"] == sum(row["count"] for row in rows)
    assert {row["of"] for row in rows} == {pruned["kept"] + sum(row["count"] for row in rows)}


def test_a_document_with_other_keys_is_noticed() -> None:
    with pytest.raises(AssertionError, match=r"\.crop\[0\]"):
        assert_same_keys({"crop": [{"kept_share": 1, "scale": 2}]}, {"crop": [{"kept_share": 1}]}, "")


def test_every_metric_is_documented(client: TestClient) -> None:
    documented = {name for name in re.findall(r"`(gapmes_\w+)`", OPERATIONS)}
    text = client.get("/metrics").text
    kinds = dict(re.findall(r"^# TYPE (gapmes_\w+) (\w+)$", text, re.MULTILINE))
    assert documented == set(kinds)
    assert set(kinds.values()) <= {"counter", "histogram", "gauge"}


def test_everything_in_a_store_is_documented(client: TestClient, settings: Settings) -> None:
    assert post(client, [photograph(70), photograph(71)]).status_code in (200, 201)
    there = {"<32 hex digits>" if is_id(path.name) else path.name for path in settings.store.iterdir()}
    listed = set(re.findall(r"`([^`]+?)/?`", " ".join(re.findall(r"^\| (.*?) \|", OPERATIONS, re.MULTILINE))))
    assert {"<32 hex digits>", "index.sqlite"} <= there <= listed
