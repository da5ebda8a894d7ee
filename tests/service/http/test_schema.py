"""The service follows its own schema: schemathesis sends every route valid and invalid requests."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
import schemathesis
from http_requests import post
from hypothesis import HealthCheck, Phase, given, settings
from schemathesis.specs.openapi.checks import positive_data_acceptance
from test_serve import serving

from gapmes.service.cameras.camera_file import parse_camera_file
from gapmes.service.cameras.depth_range import depth_range
from gapmes.service.cameras.view_checks import check_views
from gapmes.service.http.form import CAMERAS

# What a photograph, a file of Gaussians, a camera, a view or a place in the list is, a schema cannot say: some that
# fits it is refused.
SAID_IN_WORDS = ("POST /reconstruct", "POST /check", "POST /scenes", "GET /render", "GET /scenes")
SAID_IN_WORDS += ("GET /scenes/{scene_id}/preview",)


@pytest.fixture(scope="module")
def schema(standin_model: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[schemathesis.BaseSchema]:
    """The schema of a service with a scene in it."""
    folder = tmp_path_factory.mktemp("schema")
    with serving(folder / "scenes", standin_model, folder / "log") as (client, _):
        assert post(client).status_code == 201
        yield schemathesis.openapi.from_url(f"{client.base_url}/openapi.json")


def test_every_route_keeps_to_the_schema(schema: schemathesis.BaseSchema) -> None:
    """No server error, no status or type of content that is not declared, no valid request refused as malformed."""
    operations = [result.ok() for result in schema.get_all_operations()]
    asked = {operation.label for operation in operations}
    assert {"POST /reconstruct", "GET /render", "GET /jobs/{job_id}/events", "GET /metrics"} <= asked
    for operation in operations:
        holds(operation)


def holds(operation: schemathesis.APIOperation) -> None:
    """Whatever is asked of this route."""
    asked = operation.label.replace("HEAD", "GET")
    excluded = [positive_data_acceptance] if asked in SAID_IN_WORDS else []

    @settings(
        max_examples=25,
        derandomize=True,
        database=None,
        phases=[Phase.explicit, Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(case=operation.as_strategy())
    def ask(case: schemathesis.Case) -> None:
        case.call_and_validate(timeout=30, excluded_checks=excluded)

    ask()


def test_the_example_of_cameras_is_one() -> None:
    cameras = parse_camera_file(json.loads(CAMERAS)).cameras
    assert [camera.width for camera in cameras] == [640, 640]
    check_views(cameras, depth_range(cameras, 1.0, 10.0))
