"""`GET /scenes/{id}/preview` and `/sheet`: their contents, their cost limits, and when drawing ends early."""

from __future__ import annotations

import asyncio
import io
import re
import threading
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest
from http_requests import assert_problem, photograph, post
from PIL import Image, ImageSequence
from starlette.testclient import TestClient

from gapmes.service.http import drawing
from gapmes.service.pictures import film
from gapmes.service.pictures.contact_sheet import CELL, GAP
from gapmes.service.pictures.picture_error import psnr

needs_av = pytest.mark.skipif(find_spec("av") is None, reason="pip install 'gapmes[video]'")


@pytest.fixture(scope="module")
def scene(client: TestClient) -> dict[str, Any]:
    return post(client, [photograph(90), photograph(91)]).json()


def frames(data: bytes) -> tuple[list[np.ndarray], list[int]]:
    """Pictures of a WebP or GIF, and how long each is shown in ms."""
    pictures, times = [], []
    with Image.open(io.BytesIO(data)) as image:
        for frame in ImageSequence.Iterator(image):
            frame.load()
            times.append(frame.info["duration"])
            pictures.append(np.asarray(frame.convert("RGB")))
    return pictures, times


def test_a_preview_is_a_small_film_that_begins_anew(client: TestClient, scene: dict[str, Any]) -> None:
    answer = client.get(scene["links"]["preview"])
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"] == "image/webp"
    assert re.fullmatch(r"wait;dur=[\d.]+, draw;dur=[\d.]+, encode;dur=[\d.]+", answer.headers["server-timing"])
    pictures, times = frames(answer.content)
    fitted = scene["view_cameras"][0]
    assert {picture.shape for picture in pictures} == {(fitted["height"], fitted["width"], 3)}
    assert 12 <= len(pictures) <= 24  # neighbours that are equal, at the ends of the swing, are kept as one
    assert sum(times) == 2000
    with Image.open(io.BytesIO(answer.content)) as image:
        assert image.info["loop"] == 0


@pytest.mark.parametrize("kind", ["webp", "gif"])
def test_a_film_through_the_inputs_shows_them(client: TestClient, scene: dict[str, Any], kind: str) -> None:
    asked = {"path": "inputs", "format": kind, "frames": "8", "seconds": "0.8", "width": "128", "background": "white"}
    pictures, times = frames(client.get(scene["links"]["preview"], params=asked).content)
    assert sum(times) == 800
    ends = np.cumsum(times)
    for view, frame in (("0", 0), ("1", 4)):  # the last input is met half way
        link = {"scene": scene["id"], "view": view, "width": "128", "background": "white"}
        whole = np.asarray(Image.open(io.BytesIO(client.get("/render", params=link).content)))
        shown = pictures[int(np.searchsorted(ends, 100 * frame + 50))]
        assert shown.shape == whole.shape
        # measured: 27.2 at worst, of noise; the other input has 13
        assert psnr(*(pixels.astype(float).transpose(2, 0, 1) / 255 for pixels in (shown, whole))) > 25


@needs_av
def test_an_mp4_has_even_sides(client: TestClient, scene: dict[str, Any]) -> None:
    import av

    for asked, size in (({}, (64, 48)), ({"width": "50"}, (50, 38)), ({"width": "20", "height": "36"}, (20, 36))):
        answer = client.get(scene["links"]["preview"], params={"format": "mp4", "frames": "5", **asked})
        assert answer.status_code == 200, answer.text
        assert answer.headers["content-type"] == "video/mp4"
        with av.open(io.BytesIO(answer.content)) as container:
            found = [frame.to_ndarray(format="rgb24").shape for frame in container.decode(video=0)]
        assert found == [(size[1], size[0], 3)] * 5
    odd = client.get(scene["links"]["preview"], params={"format": "mp4", "width": "51"})
    assert "51 px, MP4 needs an even number" in assert_problem(odd, 422, "invalid_input", "width")["detail"]


def test_a_service_without_pyav_says_so(
    client: TestClient, scene: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(film, "find_spec", lambda _: None)
    answer = client.get(scene["links"]["preview"], params={"format": "mp4"})
    assert "gapmes[video]" in assert_problem(answer, 422, "invalid_input", "format")["cure"]


@pytest.mark.parametrize("kind", ["preview", "sheet"])
def test_what_a_client_has_is_not_drawn_again(
    client: TestClient, scene: dict[str, Any], kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = scene["links"][kind]
    first = client.get(link, params={"format": "webp"})
    assert first.headers["cache-control"] == "private, max-age=3600"
    other = client.get(link, params={"format": "webp", "background": "white"})
    assert other.headers["etag"] != first.headers["etag"]
    assert client.get(link, params={"format": "webp"}).content == first.content  # the same bits
    monkeypatch.setattr(drawing, "effort_draw", None)
    held = client.get(link, params={"format": "webp"}, headers={"If-None-Match": first.headers["etag"]})
    assert (held.status_code, held.content) == (304, b"")
    assert held.headers["etag"] == first.headers["etag"]


@pytest.mark.parametrize("kind", ["png", "jpeg", "webp"])
def test_a_sheet_has_the_inputs_side_by_side(client: TestClient, scene: dict[str, Any], kind: str) -> None:
    answer = client.get(scene["links"]["sheet"], params={"format": kind})
    assert answer.headers["content-type"] == f"image/{kind}"
    with Image.open(io.BytesIO(answer.content)) as image:
        assert (image.format, image.width) == (kind.upper(), 2 * (CELL + GAP) + GAP)
        pixels = np.asarray(image.convert("RGB"))
    drawn = np.asarray(Image.open(io.BytesIO(client.get(scene["links"]["views"][1]).content)))
    height, width = drawn.shape[:2]
    second = pixels[:, 2 * GAP + CELL :][:, :width]
    found = [top for top in range(len(second) - height) if (second[top : top + height] == drawn).all()]
    assert len(found) == (kind == "png")  # to the bit where nothing is lost


def test_the_list_has_the_links_too(client: TestClient, scene: dict[str, Any]) -> None:
    found = client.get("/scenes").json()["scenes"][0]["links"]
    assert {name: scene["links"][name] for name in ("preview", "sheet")} == {
        "preview": f"/scenes/{scene['id']}/preview",
        "sheet": f"/scenes/{scene['id']}/sheet",
    }
    assert client.get(found["preview"]).status_code == client.get(found["sheet"]).status_code == 200


@pytest.mark.parametrize(
    ("query", "code", "field", "words"),
    [
        (
            "frames=120&seconds=9&width=300&height=300",
            "invalid_input",
            "frames",
            "120 pictures of up to 300 x 300 are 10800000 px",
        ),
        ("frames=120&seconds=2", "invalid_input", "seconds", "60 per second, the limit is 50"),
        ("frames=121", "parameter_invalid", "frames", ""),
        ("frames=1", "parameter_invalid", "frames", ""),
        ("seconds=0.1", "parameter_invalid", "seconds", ""),
        ("seconds=nan", "parameter_invalid", "seconds", ""),
        ("width=100000", "parameter_invalid", "width", ""),
        ("format=avi", "parameter_invalid", "format", ""),
        ("path=spiral", "parameter_invalid", "path", ""),
        ("pth=orbit", "parameter_invalid", "pth", ""),
        ("path=orbit&swing=10", "view_unknown", "swing", "goes with the path turntable, not with orbit"),
        ("background=reddish", "view_unknown", "background", ""),
    ],
)
def test_what_cannot_be_shown_is_refused_before_it_is_drawn(
    client: TestClient, scene: dict[str, Any], query: str, code: str, field: str, words: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(drawing, "effort_draw", None)
    assert words in assert_problem(client.get(f"{scene['links']['preview']}?{query}"), 422, code, field)["detail"]


def test_a_sheet_has_no_more_pixels_than_a_picture(
    client: TestClient, scene: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A scene that was loaded may have a hundred views."""
    views = scene["view_cameras"]
    pixels = sum(camera["width"] * camera["height"] for camera in views)
    assert all(max(camera["width"], camera["height"]) <= CELL for camera in views)
    runtime = client.app.state.runtime  # type: ignore[attr-defined]
    monkeypatch.setattr(runtime, "settings", runtime.settings.model_copy(update={"max_render_pixels": pixels - 1}))
    monkeypatch.setattr(drawing, "effort_draw", None)
    problem = assert_problem(client.get(scene["links"]["sheet"]), 422, "invalid_input", "scene")
    assert problem["detail"].endswith(f"are {pixels} px, the limit is {pixels - 1}")


@pytest.mark.parametrize("scene_id", ["0" * 32, "nothing", "..%2f..", "a/b", "a" * 300])
@pytest.mark.parametrize("kind", ["preview", "sheet"])
def test_unknown_scenes(client: TestClient, scene_id: str, kind: str) -> None:
    assert_problem(client.get(f"/scenes/{scene_id}/{kind}"), 404, "scene_not_found")
    assert_problem(client.delete(f"/scenes/{scene_id}/{kind}"), 404, "scene_not_found")


def test_a_full_queue_is_503(client: TestClient, scene: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client.app.state.runtime.pictures.limit, "most", 0)
    for kind in ("preview", "sheet"):
        assert_problem(client.get(scene["links"][kind]), 503, "service_busy")


def test_drawing_ends_when_the_client_leaves(
    client: TestClient, scene: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The client disconnects while the third picture is drawn: that one is the last."""
    drawn = []
    left = threading.Event()
    original = drawing.effort_draw

    def counted(*arguments: Any, **options: Any) -> Any:
        drawn.append(1)
        if len(drawn) == 3:
            left.set()
        return original(*arguments, **options)

    monkeypatch.setattr(drawing, "effort_draw", counted)
    asked = iter([{"type": "http.request", "body": b"", "more_body": False}])

    async def receive() -> dict[str, Any]:
        for message in asked:
            return message
        while not left.is_set():
            await asyncio.sleep(0.001)
        return {"type": "http.disconnect"}

    sent: list[dict[str, Any]] = []

    async def send(message: dict[str, Any]) -> None:
        sent.append(message)

    scope = {
        "type": "http", "method": "GET", "path": f"/scenes/{scene['id']}/preview", "query_string": b"frames=60",
        "headers": [],
    }  # fmt: skip
    client.portal.call(client.app, scope, receive, send)
    assert len(drawn) == 3
    assert sent[0]["status"] == 400
    assert client.get(scene["links"]["views"][0]).status_code == 200  # its turn has passed on
