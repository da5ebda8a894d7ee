"""docs/http.md names every error code with its status, every route, and every parameter of GET /render."""

from __future__ import annotations

import re
from pathlib import Path

from starlette.testclient import TestClient

from gapmes.service import errors
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
    assert documented_codes() == expected


def test_every_route_and_parameter_is_documented(client: TestClient) -> None:
    for path, methods in client.get("/openapi.json").json()["paths"].items():
        shown = path.replace("{scene_id}", "{id}")
        for method in methods:
            assert re.search(rf"`{method.upper()} {re.escape(shown)}`", TEXT), (method, path)
    for name in (*RenderQuery.model_fields, *FIELDS):
        assert f"`{name}`" in TEXT, name
