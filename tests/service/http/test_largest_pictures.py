"""Pictures of more pixels than `GAPMES_MAX_RENDER_PIXELS`: refused with the greatest width that is drawn."""

from __future__ import annotations

import re

import numpy as np
import pytest
from http_requests import assert_problem, photograph, post
from starlette.testclient import TestClient

from gapmes.service.cameras.camera import Camera
from gapmes.service.errors import InputError
from gapmes.service.http.drawing import check_size
from gapmes.service.viewpoints.framing import frame


def offered(cure: str) -> tuple[int, int]:
    words = r"ask for a smaller picture(?: or fewer samples)?, as with width=(\d+)&height=(\d+)"
    width, height = re.fullmatch(words, cure).groups()
    return int(width), int(height)


@pytest.mark.parametrize("samples", [1, 3])
@pytest.mark.parametrize("limit", [8_000_000, 12_345, 999])
@pytest.mark.parametrize(("width", "height"), [(4032, 3024), (3024, 4032), (9000, 901), (65535, 7), (5000, 65535)])
def test_the_width_is_the_greatest_that_is_drawn(width: int, height: int, limit: int, samples: int) -> None:
    camera = Camera(width, height, 900.0, 900.0, width / 2, height / 2, np.eye(4))
    if width * height * samples**2 <= limit:
        assert check_size(camera, limit, samples) is camera
        return
    with pytest.raises(InputError, match=f"{width} x {height} with {samples} x {samples} samples") as refused:
        check_size(camera, limit, samples)
    greatest = offered(refused.value.cure)
    found = check_size(frame(camera, *greatest), limit, samples)
    assert (found.width, found.height) == greatest
    with pytest.raises(InputError):
        check_size(frame(camera, greatest[0] + 1), limit, samples)


@pytest.mark.parametrize("size", ["", "&width=60", "&height=100", "&width=100&height=100"])
def test_a_link_that_is_refused_is_drawn_with_it(
    client: TestClient, monkeypatch: pytest.MonkeyPatch, size: str
) -> None:
    scene = post(client, [photograph(7), photograph(8)]).json()
    runtime = client.app.state.runtime  # type: ignore[attr-defined]
    monkeypatch.setattr(runtime, "settings", runtime.settings.model_copy(update={"max_render_pixels": 999}))
    link = scene["links"]["views"][1]
    problem = assert_problem(client.get(f"{link}{size}"), 422, "invalid_input", "width", cured=True)
    width, height = offered(problem["cure"])
    assert client.get(f"{link}&width={width}&height={height}").status_code == 200
