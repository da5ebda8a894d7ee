"""Captures over HTTP: zips, cameras in every format beside photographs, and the choice of views."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from capture_scenes import (
    WRITERS,
    arc,
    colmap_model,
    llff_rows,
    names,
    photograph,
    realestate10k_text,
    write_colmap,
    write_llff,
    write_transforms,
    zipped,
)
from http_requests import MAX_UPLOAD, assert_problem, camera_object, stored
from http_requests import photograph as noise
from starlette.testclient import TestClient

from gapmes.service.cameras.distortion import Lens
from gapmes.service.jobs.work import Work
from gapmes.service.leaving_out.budget import Budget
from gapmes.service.settings import Settings

DEPTHS = {"near": "2", "far": "8", "trust_poses": "true", "leave_one_out": "0"}


def post_capture(client: TestClient, data: bytes, *, prefer: str | None = None, **fields: str) -> Any:
    parts: list[Any] = [("capture", ("capture.zip", data, "application/zip"))]
    parts += [(name, (None, value)) for name, value in (DEPTHS | fields).items()]
    return client.post("/reconstruct", files=parts, headers={} if prefer is None else {"Prefer": prefer})


def post_parts(client: TestClient, cameras: bytes, posted: list[str], **fields: str) -> Any:
    """`posted` has a photograph's seed and its name each: `3|c.png`."""
    parts: list[Any] = []
    for seed, _, name in (text.partition("|") for text in posted):
        parts.append(("images", (name, photograph(int(seed)))))
    parts.append(("cameras", ("cameras", cameras)))
    parts += [(name, (None, value)) for name, value in (DEPTHS | fields).items()]
    return client.post("/reconstruct", files=parts)


def centres(document: dict[str, Any]) -> np.ndarray:
    return np.array([np.array(camera["c2w"])[:3, 3] for camera in document["cameras"]])


def expected(*views: int, count: int) -> np.ndarray:
    return np.array([arc(count)[view].center for view in views])


@pytest.mark.parametrize("form", WRITERS)
def test_a_zip_of_every_format_is_the_same_scene(client: TestClient, tmp_path: Path, form: str) -> None:
    WRITERS[form](tmp_path, arc(3))
    answer = post_capture(client, zipped(tmp_path, inside="capture/"))
    assert answer.status_code in (200, 201), answer.text
    document = answer.json()
    np.testing.assert_allclose(centres(document), expected(0, 1, 2, count=3), atol=1e-12)
    said = document["selection"]
    assert (said["by"], said["of"], said["views"]) == ("all", 3, [0, 1, 2])
    assert document["images"] == said["images"]
    assert document["paired_by"] == ("sorted name" if form == "llff" else "name")


def test_of_a_large_capture_three_views_are_chosen(client: TestClient, tmp_path: Path) -> None:
    write_colmap(tmp_path, arc(12))
    data = zipped(tmp_path)
    document = post_capture(client, data).json()
    said = document["selection"]
    assert (said["by"], said["of"], said["compared"], len(said["views"])) == ("score", 12, 12, 3)
    np.testing.assert_allclose(centres(document), expected(*said["views"], count=12), atol=1e-12)
    assert document["images"] == [f"images/{names(12)[view]}" for view in said["views"]]
    again = post_capture(client, data, select=",".join(map(str, said["views"])))
    assert (again.status_code, again.json()["id"]) == (200, document["id"])
    assert again.json()["selection"]["by"] == "select"
    assert len(post_capture(client, data, context="5").json()["cameras"]) == 5
    by_name = post_capture(client, data, select="view 0007.png, left side/view 0003.png").json()
    np.testing.assert_allclose(centres(by_name), expected(7, 3, count=12), atol=1e-12)


def test_a_job_says_what_was_chosen(client: TestClient, tmp_path: Path) -> None:
    """The scene document is the same for everyone, so the answer to the request has it."""
    write_colmap(tmp_path, arc(8))
    answer = post_capture(client, zipped(tmp_path), prefer="respond-async")
    assert answer.status_code == 202
    assert (answer.json()["selection"]["by"], len(answer.json()["selection"]["views"])) == ("score", 3)
    assert "selection" not in client.get(answer.headers["location"]).json()


def test_cameras_of_every_format_beside_photographs(client: TestClient, tmp_path: Path) -> None:
    cameras = arc(3)
    colmap, npy = tmp_path / "model", io.BytesIO()
    colmap.mkdir()
    colmap_model(cameras, names(3)).write_text(str(colmap))
    np.save(npy, llff_rows(cameras))
    stamps = [f"{1_000_000 + 33_366 * index}.png" for index in range(3)]
    plain = [name.split("/")[1] for name in names(3)]
    for data, posted, by in (
        (zipped(colmap), plain, "name"),
        (npy.getvalue(), plain, "sorted name"),
        (realestate10k_text(cameras).encode(), stamps, "name"),
        (realestate10k_text(cameras).encode(), plain, "order"),
    ):
        answer = post_parts(client, data, [f"{place}|{name}" for place, name in enumerate(posted)])
        assert answer.status_code in (200, 201), answer.text
        assert answer.json()["paired_by"] == by
        np.testing.assert_allclose(centres(answer.json()), expected(0, 1, 2, count=3), atol=1e-12)


def test_rows_of_an_array_belong_to_sorted_names(client: TestClient) -> None:
    """Whatever order the photographs are sent in; another number of them cannot be told apart."""
    npy = io.BytesIO()
    np.save(npy, llff_rows(arc(3)))
    answer = post_parts(client, npy.getvalue(), ["2|c.png", "0|a.png", "1|b.png"])
    np.testing.assert_allclose(centres(answer.json()), expected(2, 0, 1, count=3), atol=1e-12)
    body = assert_problem(post_parts(client, npy.getvalue(), ["0|a.png", "1|b.png"]), 422, "view_count", "cameras")
    assert body["detail"] == "3 cameras for 2 images"


def test_near_and_far_of_an_array_are_those_of_the_chosen_rows(client: TestClient, tmp_path: Path) -> None:
    write_llff(tmp_path, arc(8))
    parts = [("capture", ("c.zip", zipped(tmp_path))), ("select", (None, "3,4")), ("trust_poses", (None, "true"))]
    document = client.post("/reconstruct", files=parts).json()
    assert (document["near"], document["far"]) == (1.6, 13.0)


def test_more_than_six_photographs_are_an_accident_unless_a_choice_is_asked_for(client: TestClient) -> None:
    count = 60
    posted = [f"{index}|{name.split('/')[1]}" for index, name in enumerate(names(count))]
    views = realestate10k_text(arc(count)).encode()
    body = assert_problem(post_parts(client, views, posted), 422, "view_count", "images")
    assert body["detail"] == "60 images, need 2 to 6"
    assert "`context`" in body["cure"]
    document = post_parts(client, views, posted, context="2").json()
    said = document["selection"]
    assert (said["by"], said["of"], len(said["views"])) == ("score", 60, 2)
    assert document["images"] == [posted[view].split("|")[1] for view in said["views"]]
    lines = views.splitlines()
    lines[8] = b" ".join([*lines[8].split()[:7], b"9", *lines[8].split()[8:]])
    broken = b"\n".join(lines)  # no rotation is in view 7
    document = post_parts(client, broken, posted, context="2").json()
    assert 7 not in document["selection"]["views"]
    (refused,) = [warning for warning in document["warnings"] if warning["code"] == "views_refused"]
    assert refused["message"].startswith("1 of 60 views have no camera that can be used, the first is 7: ")
    assert refused["index"] == 7
    assert_problem(post_parts(client, broken, posted, select="7,9"), 422, "pose_not_rotation", index=7)
    assert len(post_parts(client, broken, posted, select="8,9").json()["cameras"]) == 2
    document = post_parts(client, views, posted, select="view 0007.png,9").json()
    np.testing.assert_allclose(centres(document), expected(7, 9, count=count), atol=1e-12)


def test_photographs_through_a_lens(client: TestClient, tmp_path: Path, settings: Settings) -> None:
    """Resampled in the work, which keeps the lens over a restart; another lens is another scene."""
    write_transforms(tmp_path, arc(2))
    path = tmp_path / "transforms.json"
    plain = json.loads(path.read_text())
    ids = []
    for k1 in (0.0, -0.1, -0.12):
        path.write_text(json.dumps(plain | {"k1": k1}))
        document = post_capture(client, zipped(tmp_path)).json()
        told = [warning for warning in document["warnings"] if warning["code"] == "undistorted"]
        assert len(told) == (2 if k1 else 0)
        ids.append(document["id"])
    assert len(set(ids)) == 3


def test_work_keeps_its_lenses() -> None:
    lens = Lens(96, 72, 80.0, 80.0, 48.0, 36.0, k1=-0.1, r8=1e-17)
    work = Work((b"a", b"b"), tuple(arc(2)), None, None, False, 2, Budget(), lenses=(lens, None))
    again = Work.of_document(json.loads(json.dumps(work.document())), work.images)
    assert again.lenses == (lens, None)
    assert again.scene_id("x") == work.scene_id("x")
    bare = Work(work.images, work.cameras, None, None, False, 2, work.budget)
    assert bare.scene_id("x") != work.scene_id("x")
    document = bare.document()
    del document["lenses"]
    assert Work.of_document(document, work.images).scene_id("x") == bare.scene_id("x")


@pytest.mark.parametrize(
    ("fields", "code", "field"),
    [
        ({"context": "7"}, "view_count", "context"),
        ({"context": "0"}, "view_count", "context"),
        ({"context": "many"}, "invalid_input", "context"),
        ({"context": "2", "select": "0,1"}, "invalid_input", "context"),
        ({"select": "0"}, "view_count", "select"),
        ({"select": "0,1,2,3,4,5,6"}, "view_count", "select"),
        ({"select": "0,99"}, "view_unknown", "select"),
        ({"select": "0,0"}, "view_unknown", "select"),
        ({"select": "nothing.png"}, "view_unknown", "select"),
        ({"cameras": "{}"}, "invalid_input", "capture"),
        ({"images": "x"}, "invalid_input", "capture"),
        ({"capture": "x"}, "invalid_input", "capture"),
    ],
)
def test_refused_choices(
    client: TestClient, tmp_path: Path, settings: Settings, fields: dict[str, str], code: str, field: str
) -> None:
    write_colmap(tmp_path, arc(8))
    before = stored(settings)
    assert_problem(post_capture(client, zipped(tmp_path), **fields), 422, code, field)
    assert stored(settings) == before


@pytest.mark.parametrize("fields", [{}, {"context": "2"}])
def test_a_capture_of_one_view_is_no_job(client: TestClient, tmp_path: Path, fields: dict[str, str]) -> None:
    """It is refused before it is queued."""
    write_colmap(tmp_path, arc(1))
    answer = post_capture(client, zipped(tmp_path), prefer="respond-async", **fields)
    assert_problem(answer, 422, "view_count")


@pytest.mark.parametrize("data", [b"", b"PK\x03\x04", b"no zip at all", b"PK\x05\x06" + bytes(18)])
def test_refused_captures(client: TestClient, data: bytes) -> None:
    assert_problem(post_capture(client, data), 422, "capture_invalid", "capture")


def test_a_capture_as_a_text_field(client: TestClient) -> None:
    answer = client.post("/reconstruct", files=[("capture", (None, "PK"))])
    assert_problem(answer, 422, "invalid_input", "capture")


def test_empty_fields_of_the_other_kind_of_form_count_as_missing(client: TestClient, tmp_path: Path) -> None:
    """Tools that fill in a form from the OpenAPI document send all of its fields."""
    write_colmap(tmp_path, arc(3))
    assert post_capture(client, zipped(tmp_path), images="", cameras="").status_code in (200, 201)
    parts = [("images", (f"{seed}.png", noise(seed), "image/png")) for seed in (70, 71)]
    cameras = ("cameras", (None, json.dumps(camera_object(2))))
    answer = client.post("/reconstruct", files=[*parts, cameras, ("capture", (None, ""))])
    assert answer.status_code in (200, 201), answer.text


def test_a_zip_without_a_model_as_cameras(client: TestClient, tmp_path: Path) -> None:
    (tmp_path / "a.md").write_text("x")
    answer = post_parts(client, zipped(tmp_path), ["0|a.png", "1|b.png"])
    assert_problem(answer, 422, "capture_invalid", "cameras")


def test_too_many_views_in_a_capture(client: TestClient, tmp_path: Path) -> None:
    """Two thousand and one lines, no photograph: refused before anything is looked for."""
    lines = realestate10k_text(arc(1)).splitlines()
    (tmp_path / "clip.txt").write_text("\n".join([lines[0], *[lines[1]] * 2001]))
    body = assert_problem(post_capture(client, zipped(tmp_path)), 422, "invalid_input", "capture")
    assert body["detail"] == "has 2001 views, the limit is 2000"


def test_photographs_that_unpack_to_more_than_a_request_may_hold(client: TestClient) -> None:
    """A picture with zeros behind its end passes for one, and shrinks to nothing in a zip."""
    cameras = camera_object(2)
    for index, view in enumerate(cameras["views"]):
        view["image"] = f"{index}.png"
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as made:
        made.writestr("cameras.json", json.dumps(cameras))
        for index in range(2):
            made.writestr(f"{index}.png", noise(index) + bytes(MAX_UPLOAD - 20_000))
    assert len(buffer.getvalue()) < MAX_UPLOAD // 10
    answer = client.post("/reconstruct", files=[("capture", ("capture.zip", buffer.getvalue()))])
    body = assert_problem(answer, 413, "upload_too_large", "capture")
    assert f"the limit is {MAX_UPLOAD}" in body["detail"]


def test_refusals_and_warnings_name_views_as_the_capture_counts_them(client: TestClient) -> None:
    cameras = camera_object(4)
    for index, view in enumerate(cameras["views"]):
        view["image"] = f"{index}.png"

    def posted(route: str, photographs: list[bytes], select: str, cameras: object) -> Any:
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w") as made:
            made.writestr("cameras.json", json.dumps(cameras))
            for index, data in enumerate(photographs):
                made.writestr(f"{index}.png", data)
        parts = [("capture", ("capture.zip", buffer.getvalue())), ("select", (None, select))]
        return client.post(route, files=parts)

    good = [noise(index) for index in range(4)]
    torn = [*good[:3], good[3][:-200]]
    tall = [*good[:3], noise(3, 72, 96)]
    twice = json.loads(json.dumps(cameras))
    twice["views"][3]["c2w"] = twice["views"][1]["c2w"]
    for route in ("/check", "/reconstruct"):
        assert_problem(posted(route, torn, "1,3", cameras), 415, "image_unreadable", index=3)
        assert_problem(posted(route, tall, "1,3", cameras), 422, "image_invalid", index=3)
        body = assert_problem(posted(route, good, "2,1,3", twice), 422, "no_baseline", index=3)
        assert "views 1 and 3 have the same pose" in body["detail"]


def test_models_that_were_passed_over_are_told(client: TestClient, tmp_path: Path) -> None:
    """Of a capture and of a zip beside photographs, by the reconstruction and by the check."""
    write_colmap(tmp_path, arc(3))
    write_colmap(tmp_path, arc(2), "sparse/1")
    data = zipped(tmp_path)
    posted = [f"{index}|{name.split('/')[1]}" for index, name in enumerate(names(3))]
    parts = [("capture", ("capture.zip", data)), *((name, (None, value)) for name, value in DEPTHS.items())]
    for answer, field in (
        (post_capture(client, data), "capture"),
        (client.post("/check", files=parts), "capture"),
        (post_parts(client, data, posted), "cameras"),
    ):
        (told,) = [warning for warning in answer.json()["warnings"] if warning["code"] == "several_models"]
        assert told["field"] == field
        assert "sparse/0 (3 images) is read; ignored: sparse/1 (2 images)" in told["message"]
