"""POST /scenes: files of Gaussians become scenes that are listed, drawn, orbited, served and deleted like any other."""

from __future__ import annotations

import io
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from capture_scenes import arc, write_colmap, zipped
from format_cases import moderate, spz_file
from http_requests import MAX_UPLOAD, assert_problem, camera_object, stored
from loading import file_of, load_form, load_raw
from PIL import Image
from starlette.testclient import TestClient

from gapmes.service.app import create_app
from gapmes.service.formats.dialect import STANDARD
from gapmes.service.formats.ply import inspect_ply, ply_bytes
from gapmes.service.formats.registry import FORMATS
from gapmes.service.gaussians import Gaussians
from gapmes.service.http import preview
from gapmes.service.http.schemas import FormatName
from gapmes.service.pictures.contact_sheet import Row, contact_sheet
from gapmes.service.settings import Settings
from gapmes.service.viewpoints.default_framing import default_views

pytestmark = pytest.mark.usefixtures("no_scene_stays")


@pytest.mark.parametrize("name", FORMATS)
def test_a_file_of_every_format_becomes_a_scene(client: TestClient, name: str) -> None:
    data = file_of(name, 1)
    answer = load_form(client, data, f"A scene.{name}")
    assert answer.status_code == 201, answer.text
    scene = answer.json()
    assert answer.headers["location"] == f"/scenes/{scene['id']}"
    assert scene["model"] is None
    assert (scene["file"]["format"], scene["file"]["bytes"], scene["file"]["rows"]) == (name, len(data), 300)
    assert scene["gaussians"] == {"count": 300, "sh_degree": 0 if name == "splat" else 1}
    assert scene["depth_range_source"] == "framing"
    assert client.get(f"/scenes/{scene['id']}").json() == scene
    kept = inspect_ply(client.get(scene["links"]["ply"]).content).gaussians
    expected = FORMATS[name].read(data, STANDARD, False, None).gaussians
    assert np.abs(kept.means - expected.means).max() <= 1e-6
    again = load_form(client, data, "another name", format=name)
    assert (again.status_code, again.json()["id"]) == (200, scene["id"])
    raw = load_raw(client, data, format=name)
    assert (raw.status_code, raw.json()["id"]) == (200, scene["id"])
    [listed] = [row for row in client.get("/scenes").json()["scenes"] if row["id"] == scene["id"]]
    assert (listed["file"], listed["views"], listed["gaussians"]) == (name, 1, 300)
    assert listed["links"]["views"] == [f"/render?scene={scene['id']}&view=0"]


def test_of_equal_files_at_once_one_is_new(client: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is converted once for all of them, where they wait for each other; and stored once in any case."""
    together, looks, converted = threading.Barrier(4), count(), []
    store, given = client.app.state.runtime.store, file_of("splat", 77)
    exists, decode = store.listed, FORMATS["splat"].decode

    def all_find_none(scene_id: str) -> bool:
        found = exists(scene_id)
        if next(looks) < 4:
            together.wait(60)
        return found

    monkeypatch.setattr(store, "listed", all_find_none)
    counting = replace(FORMATS["splat"], decode=lambda *args: converted.append(1) or decode(*args))
    monkeypatch.setitem(FORMATS, "splat", counting)
    with ThreadPoolExecutor(4) as pool:
        answers = list(pool.map(lambda _: load_raw(client, given, format="splat"), range(4)))
    assert sorted(answer.status_code for answer in answers) == [200, 200, 200, 201]
    assert len({answer.text for answer in answers}) == 1
    assert len(converted) == 1


def test_it_is_drawn_orbited_and_deleted(client: TestClient, settings: Settings) -> None:
    before = stored(settings)
    scene = load_raw(client, file_of("ply", 2)).json()
    for view in ("0", "orbit:30", "orbit:180"):
        answer = client.get("/render", params={"scene": scene["id"], "view": view, "channel": "alpha", "width": 64})
        assert answer.status_code == 200, answer.text
        assert np.asarray(Image.open(io.BytesIO(answer.content))).mean() > 20, view
    assert client.get("/render", params={"view": "0"}).headers["x-gapmes-scene"] == scene["id"]  # the newest
    assert client.delete(scene["links"]["self"]).status_code == 204
    assert stored(settings) == before


def links_of(found: Any) -> Iterator[str]:
    """Every link of a document, however deep."""
    if isinstance(found, str):
        yield found
    else:
        for link in found.values() if isinstance(found, dict) else found:
            yield from links_of(link)


@pytest.mark.parametrize("views", [0, 3])
def test_every_link_leads_somewhere(client: TestClient, views: int) -> None:
    """With the default framing, and with cameras of its own."""
    scene = load_form(client, file_of("ply", 7), cameras=camera_object(views) if views else None).json()
    assert set(scene["links"]) == {"self", "ply", "files", "preview", "sheet", "views"}
    for link in links_of(scene["links"]):
        answer = client.get(link)
        assert answer.status_code == 200, (link, answer.text)
        assert answer.content


def test_a_sheet_of_a_loaded_scene_has_no_scores(client: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    """There are no photographs to compare with: neither the title nor a label speaks of them."""
    drawn: list[Row] = []
    monkeypatch.setattr(preview, "contact_sheet", lambda rows: (drawn.extend(rows), contact_sheet(rows))[1])
    scene = load_form(client, file_of("ply", 8), cameras=camera_object(2)).json()
    assert client.get(scene["links"]["sheet"]).status_code == 200
    [row] = drawn
    assert (row.title, [cell.label for cell in row.cells]) == ("Views", ["view 0", "view 1"])


def test_cameras_that_were_passed_over_are_told(client: TestClient, tmp_path: Path) -> None:
    write_colmap(tmp_path, arc(3))
    write_colmap(tmp_path, arc(2), "sparse/1")
    parts = [("file", ("scene.ply", file_of("ply", 3))), ("cameras", ("cameras.zip", zipped(tmp_path)))]
    scene = client.post("/scenes", files=parts).json()
    assert len(scene["view_cameras"]) == 3
    (told,) = [warning for warning in scene["warnings"] if warning["code"] == "several_models"]
    assert told["field"] == "cameras"


def test_cameras_and_depths_may_be_given(client: TestClient) -> None:
    data, cameras = file_of("ply", 3), camera_object(3)
    scene = load_form(client, data, cameras=cameras).json()
    assert len(scene["view_cameras"]) == 3
    assert scene["view_cameras"][1]["c2w"] == cameras["views"][1]["c2w"]
    assert (scene["near"], scene["far"], scene["depth_range_source"]) == (1.0, 10.0, "given")
    del cameras["near"], cameras["far"]
    seen = load_form(client, data, cameras=cameras).json()
    assert seen["depth_range_source"] == "gaussians"
    assert 1.0 <= seen["near"] < seen["far"] <= 4.0  # where the Gaussians lie
    own = load_form(client, data, cameras=cameras, near="0.5", far="7").json()
    assert (own["near"], own["far"], own["depth_range_source"]) == (0.5, 7.0, "given")
    assert len({scene["id"], seen["id"], own["id"]}) == 3
    assert client.get("/render", params={"scene": own["id"], "view": "1.5"}).status_code == 200


@pytest.mark.parametrize(
    ("data", "query", "status", "code", "field"),
    [
        (b"", {}, 422, "invalid_input", "file"),
        (b"no such file", {}, 422, "invalid_input", "format"),
        (b"ply\nno header", {}, 422, "ply_invalid", "header"),
        (bytes(33), {"format": "splat"}, 422, "format_invalid", "splat"),
        (b"", {"format": "splat"}, 422, "format_invalid", "file"),
        (spz_file(0), {}, 422, "format_invalid", "file"),
        (spz_file(2**32 - 1, body=b""), {}, 413, "too_many_gaussians", "spz"),
        (spz_file(3_000_000, body=b""), {}, 413, "too_many_gaussians", "spz"),
        (bytes(64), {"format": "obj"}, 422, "parameter_invalid", "format"),
        (bytes(64), {"opacity": "maybe"}, 422, "parameter_invalid", "opacity"),
        (bytes(64), {"colour": "red"}, 422, "parameter_invalid", "colour"),
        (bytes(64), {"near": "nan"}, 422, "parameter_invalid", "near"),
        (bytes(64), {"near": "1_0"}, 422, "parameter_invalid", "near"),
        (file_of("ply"), {"near": "5", "far": "2"}, 422, "depth_range_invalid", "near"),
        (bytes(MAX_UPLOAD + 1), {}, 413, "upload_too_large", "body"),
    ],
)
def test_what_is_refused_leaves_nothing(
    client: TestClient, settings: Settings, data: bytes, query: dict[str, str], status: int, code: str, field: str
) -> None:
    before = stored(settings)
    assert_problem(load_raw(client, data, **query), status, code, field)
    assert stored(settings) == before


@pytest.mark.parametrize("query", [{"near": "1e9"}, {"far": "1e-9"}])
def test_one_end_beyond_the_other_is_told_where_that_is_from(client: TestClient, query: dict[str, str]) -> None:
    [name] = query
    problem = assert_problem(load_raw(client, file_of("ply"), **query), 422, "depth_range_invalid", name)
    assert problem["cure"] == f"{name} alone is given, the other one is from the framing: give both"


@pytest.mark.parametrize("cameras", [b'{"views": {}}', b"3", b"images.txt"])
def test_cameras_that_are_refused_beside_a_file_have_a_cure(client: TestClient, cameras: bytes) -> None:
    parts = [("file", ("scene.ply", file_of("ply", 3))), ("cameras", ("cameras.json", cameras))]
    problem = client.post("/scenes", files=parts).json()
    assert problem["field"].startswith("cameras")
    assert ("a zipped COLMAP model" if cameras == b"images.txt" else "has an example of `cameras`") in problem["cure"]


def test_forms_that_are_none(client: TestClient) -> None:
    data = file_of("ply")
    assert_problem(client.post("/scenes", content=data), 415, "unsupported_media_type", "body")
    assert_problem(client.post("/scenes", files=[("cameras", (None, "{}"))]), 422, "invalid_input", "file")
    assert_problem(client.post("/scenes", files=[("file", (None, "text"))]), 422, "invalid_input", "file")
    twice = [("file", ("a.ply", data)), ("file", ("b.ply", data))]
    assert_problem(client.post("/scenes", files=twice), 422, "invalid_input", "file")
    flood = [("file", (f"{index}.ply", b"")) for index in range(70)]
    assert (
        "more than 64 files, need one"
        in assert_problem(client.post("/scenes", files=flood), 422, "invalid_input", "file")["detail"]
    )
    assert_problem(load_form(client, data, axes="xyz"), 422, "parameter_invalid", "axes")
    assert_problem(load_form(client, data, colour="red"), 422, "parameter_invalid", "colour")
    assert_problem(load_form(client, data, far="1_0"), 422, "parameter_invalid", "far")
    assert_problem(load_form(client, data, far="9" * 20_000), 413, "upload_too_large", "far")
    assert_problem(load_form(client, data, cameras={"views": []}), 422, "camera_invalid")
    assert_problem(load_form(client, data, cameras=camera_object(101)), 422, "invalid_input", "cameras")
    beside = client.post("/scenes", params={"axes": "rdf"}, files=[("file", ("a.ply", data))])
    assert_problem(beside, 422, "invalid_input", "axes")


def test_the_store_keeps_its_limit(standin_model: Any, tmp_path: Any) -> None:
    """A loaded scene counts like any other, and the one that was read longest ago makes room for it."""
    size = len(ply_bytes(moderate(300, 0, 1)))
    limited = Settings(model=standin_model, store=tmp_path / "scenes", threads=1, store_bytes=int(2.9 * size))
    with TestClient(create_app(limited), raise_server_exceptions=False) as client:
        ids = [load_raw(client, file_of("ply", seed)).json()["id"] for seed in range(3)]
        assert [client.get(f"/scenes/{scene_id}").status_code for scene_id in ids] == [404, 200, 200]
        assert_problem(load_raw(client, ply_bytes(moderate(900, 0, 1))), 507, "storage_full", "store")


def test_the_default_framing_holds_most_and_turns_about_the_middle() -> None:
    """Far strays and a far origin change nothing but where the camera stands."""
    source = moderate(2000, 9, 0)
    views = default_views(source)
    [camera] = views.cameras
    pixels, depth = camera.project(source.means)
    inside = ((pixels >= 0) & (pixels < 512)).all(axis=1) & (depth > 0)
    assert source.opacities[inside].sum() >= 0.8 * source.opacities.sum()
    assert views.near is not None
    assert views.far is not None
    pivot = camera.center + np.sqrt(views.near * views.far) * camera.rotation[:, 2]
    for degrees in (-90, 30, 180):
        turned = views.resolve(f"orbit:{degrees}")
        seen, _ = turned.project(pivot[None])
        assert np.abs(seen - 256).max() < 1e-6
    shift = np.array([4e6, -3e6, 1e5])
    strays = np.vstack([source.means + shift, np.array([[1e9, 0, 0], [0, -1e9, 5]]) + shift])
    pad = [np.concatenate([getattr(source, name), getattr(source, name)[:2]]) for name in ("scales", "rotations_wxyz")]
    faint = np.concatenate([source.opacities, [1e-3, 1e-3]])
    moved = Gaussians.make(strays, *pad, faint, np.concatenate([source.harmonics, source.harmonics[:2]]))
    assert np.abs(default_views(moved).cameras[0].center - shift - camera.center).max() < 0.02


def test_the_schema_names_the_formats_that_there_are() -> None:
    assert get_args(FormatName) == tuple(FORMATS)


@pytest.mark.parametrize("scale", [0.0, 0.3])
def test_a_single_gaussian_is_framed_by_its_size(scale: float) -> None:
    one = Gaussians.make([[1.0, 2.0, 3.0]], np.full((1, 3), scale), [[1, 0, 0, 0]], [0.0], np.zeros((1, 1, 3)))
    views = default_views(one)
    assert views.near is not None
    assert views.far is not None
    assert 0 < views.near < views.far
    assert np.allclose(views.cameras[0].center[:2], [1, 2])


def test_what_no_picture_can_be_drawn_of_is_refused(client: TestClient) -> None:
    for reach in (1e16, 3e38, 1e300):
        given = moderate(50, 3, 0)
        means = given.means.copy()
        means[::2, 0], means[1::2, 0] = reach, -reach
        data = ply_bytes(replace(given, means=means), positions="float64")
        body = assert_problem(load_raw(client, data), 422, "format_invalid", "file")
        assert "too large or too small to be drawn" in body["detail"]
    for unit, drawn in ((1e14, True), (1e-14, True), (1e-20, False)):
        given = moderate(50, 3, 0)
        given = replace(given, means=given.means * unit, scales=given.scales * np.float32(unit))
        answer = load_raw(client, ply_bytes(given))
        if not drawn:
            assert_problem(answer, 422, "format_invalid", "file")
            continue
        picture = client.get(f"/render?channel=alpha&width=64&height=64&scene={answer.json()['id']}")
        assert np.asarray(Image.open(io.BytesIO(picture.content))).max() > 50


@pytest.mark.parametrize(
    ("reach", "near", "far"), [(1e16, "1", "10"), (1, "1e-16", "1e-15"), (1, "1", "1e16"), (1, "1e-14", "1e14")]
)
def test_each_bound_of_what_can_be_drawn_holds_alone(client: TestClient, reach: float, near: str, far: str) -> None:
    """Of positions, near and far, with cameras that are given; the last has none beyond it."""
    given = moderate(50, 3, 0)
    means = given.means.copy()
    means[0, 0] = reach
    data = ply_bytes(replace(given, means=means), positions="float64")
    answer = load_form(client, data, cameras=camera_object(2), near=near, far=far)
    if (reach, near) == (1, "1e-14"):
        assert answer.status_code == 201
    else:
        assert_problem(answer, 422, "format_invalid", "file")


def test_bodies_that_are_no_file_of_gaussians(client: TestClient) -> None:
    body = assert_problem(load_raw(client, b""), 422, "invalid_input", "file")
    assert "0 bytes" in body["detail"]
    body = assert_problem(load_raw(client, b"\x89PNG\r\n\x1a\n" + bytes(100)), 422, "invalid_input", "format")
    assert "PNG" in body["detail"]


def test_one_bound_that_is_given_is_not_called_both(client: TestClient) -> None:
    scene = load_raw(client, file_of("ply", 5), near="0.01").json()
    assert (scene["near"], scene["depth_range_source"]) == (0.01, "framing")
