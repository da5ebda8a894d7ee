"""`POST /reconstruct` answers with a scene in three forms, pairs by name or order, and computes equal input once."""

from __future__ import annotations

import io
import json
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from http_requests import assert_problem, camera_object, photograph, post, stored, wait_until_ready
from PIL import Image
from starlette.testclient import TestClient

from gapmes.service import read_ply
from gapmes.service.app import create_app
from gapmes.service.jobs import work
from gapmes.service.reconstruct import Reconstructor
from gapmes.service.settings import Settings


@pytest.fixture(autouse=True)
def emptied(client: TestClient) -> None:
    for scene in client.get("/scenes").json()["scenes"]:
        client.delete(scene["links"]["self"])


def test_scene_document(client: TestClient) -> None:
    answer = post(client)
    assert answer.status_code == 201
    body = answer.json()
    assert answer.headers["location"] == f"/scenes/{body['id']}" == body["links"]["self"]
    assert set(body["timings"]) >= {"cameras", "images", "network", "gaussians"}
    assert (body["near"], body["far"]) == (1.0, 10.0)
    assert body["cameras"] == camera_object(2)["views"]
    assert body["model"]
    for link in (body["links"]["self"], body["links"]["ply"], *body["links"]["views"]):
        assert client.get(link).status_code == 200
    used = {"by": "all", "format": "cameras.json", "cameras": "cameras", "of": 2, "views": [0, 1]}
    names = ["0.png", "1.png"]  # of this request, not of the scene, as are the next two
    own = {"images": names, "paired_by": "order", "selection": {**used, "images": names}}
    assert client.get(body["links"]["self"]).json() | own == body


def test_same_input_is_the_same_scene(client: TestClient, settings: Settings) -> None:
    first = post(client)
    before = stored(settings)
    second = post(client)
    assert (first.status_code, second.status_code) == (201, 200)
    assert first.json() == second.json()
    assert second.headers["location"] == first.headers["location"]
    assert stored(settings) == before
    for change in (
        {"images": [photograph(0), photograph(2)]},
        {"near": "2"},
        {"cameras": camera_object(2, offset=1.0)},
    ):
        assert post(client, **change).json()["id"] != first.json()["id"]


def test_same_bytes_after_deletion(client: TestClient) -> None:
    first = post(client)
    ply = client.get(first.json()["links"]["ply"]).content
    client.delete(first.headers["location"])
    second = post(client, accept="application/octet-stream")
    assert second.status_code == 201
    assert second.content == ply


def test_posted_at_once_is_computed_once(client: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []
    original = Reconstructor.reconstruct
    monkeypatch.setattr(
        Reconstructor,
        "reconstruct",
        lambda *args, **options: calls.append(1) or original(*args, **options),
    )
    with ThreadPoolExecutor(6) as pool:
        answers = list(pool.map(lambda _: post(client), range(6)))
    assert sorted(answer.status_code for answer in answers) == [200] * 5 + [201]
    assert len({answer.text for answer in answers}) == 1
    assert len(calls) == 1


def test_ply(client: TestClient) -> None:
    answer = post(client, accept="application/octet-stream")
    assert answer.status_code == 201
    assert answer.headers["content-type"] == "application/octet-stream"
    assert answer.headers["location"]
    assert answer.content == client.get(answer.headers["location"] + ".ply").content
    assert len(read_ply(answer.content)) > 0


def test_zip(client: TestClient) -> None:
    answer = post(client, accept="application/zip", views="0, 0.5, orbit:10")
    assert answer.status_code == 201
    bundle = zipfile.ZipFile(io.BytesIO(answer.content))
    pictures = ["renders/view_0.png", "renders/view_0.5.png", "renders/view_orbit_10.png"]
    assert sorted(bundle.namelist()) == sorted(["scene.ply", "scene.json", *pictures])
    assert bundle.testzip() is None
    document = json.loads(bundle.read("scene.json"))
    assert bundle.read("scene.ply") == client.get(document["links"]["ply"]).content
    for name, link in zip(pictures, document["links"]["renders"], strict=True):
        assert bundle.read(name) == client.get(link).content
    again = post(client, accept="application/zip", views="0, 0.5, orbit:10")
    assert (again.status_code, again.content) == (200, answer.content)


@pytest.mark.parametrize(
    ("accept", "kind"),
    [
        ("*/*", "application/json"),
        ("application/*", "application/json"),
        ("application/zip, application/json;q=0.5", "application/zip"),
        ("text/html, application/octet-stream;q=0.2, */*;q=0.1", "application/octet-stream"),
    ],
)
def test_accept(client: TestClient, accept: str, kind: str) -> None:
    assert post(client, accept=accept).headers["content-type"] == kind


def test_cameras_as_a_text_field(client: TestClient) -> None:
    as_file = post(client)
    parts = [("images", ("0.png", photograph(0))), ("images", ("1.png", photograph(1)))]
    parts.append(("cameras", (None, json.dumps(camera_object(2)).encode())))
    assert client.post("/reconstruct", files=parts).json()["id"] == as_file.json()["id"]


def test_another_algorithm_is_another_scene(client: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    first = post(client)
    monkeypatch.setattr(work, "ALGORITHM_REVISION", work.ALGORITHM_REVISION + 1)
    second = post(client)
    assert second.status_code == 201
    assert second.json()["id"] != first.json()["id"]


def test_transforms_json_is_the_same_scene(client: TestClient) -> None:
    """OpenGL axes, field of view instead of focal length, and no size: it is read from the images."""
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    frames = [
        {"file_path": f"./{index}", "transform_matrix": (np.array(view["c2w"]) @ flip).tolist()}
        for index, view in enumerate(camera_object(2)["views"])
    ]
    transforms = {"fl_x": 80.0, "fl_y": 80.0, "frames": frames}
    answer = post(client, cameras=transforms, near="1", far="10")
    assert answer.status_code == 201, answer.text
    assert answer.json()["id"] == post(client).json()["id"]


@pytest.mark.parametrize("count", [2, 3, 6])
def test_number_of_views(client: TestClient, count: int) -> None:
    answer = post(client, [photograph(seed) for seed in range(count)])
    assert answer.status_code == 201, answer.text
    assert len(answer.json()["view_cameras"]) == count


def test_other_formats(client: TestClient) -> None:
    images = [photograph(0, kind="JPEG"), photograph(1, kind="WEBP")]
    assert post(client, images, names=["0.jpg", "1.webp"]).status_code == 201


def test_depth_is_estimated_and_reported(client: TestClient) -> None:
    cameras = camera_object(2)
    del cameras["near"], cameras["far"]
    body = post(client, cameras=cameras).json()
    assert 0 < body["near"] < body["far"]


def test_alpha_is_a_mask(client: TestClient) -> None:
    """The right half of every photograph is left out: about half of the Gaussians remain."""
    whole = post(client).json()
    masked = []
    for data in (photograph(0), photograph(1)):
        pixels = np.asarray(Image.open(io.BytesIO(data)))
        alpha = np.full((*pixels.shape[:2], 1), 255, np.uint8)
        alpha[:, pixels.shape[1] // 2 :] = 0
        buffer = io.BytesIO()
        Image.fromarray(np.concatenate([pixels, alpha], 2)).save(buffer, "PNG")
        masked.append(buffer.getvalue())
    half = post(client, masked).json()
    counts = [len(read_ply(client.get(body["links"]["ply"]).content)) for body in (whole, half)]
    assert 0.3 * counts[0] < counts[1] < 0.7 * counts[0]


def test_huge_world_offset(client: TestClient) -> None:
    """A million units from the origin the scene is the same scene there, and renders to the same picture."""
    offset = 1e6
    near_by, far_off = post(client).json(), post(client, cameras=camera_object(2, offset=offset)).json()
    clouds = [read_ply(client.get(body["links"]["ply"]).content) for body in (near_by, far_off)]
    # 0.2 apart at 1e6 is known to 1e6 * 2^-53 = 1e-10; the scene lies within ten units of the cameras
    np.testing.assert_allclose(clouds[1].means - offset, clouds[0].means, atol=1e-5)
    pictures = [
        np.asarray(Image.open(io.BytesIO(client.get(body["links"]["views"][1]).content))).astype(int)
        for body in (near_by, far_off)
    ]
    assert np.abs(pictures[0] - pictures[1]).max() <= 1
    assert pictures[0].max() > 0


def test_trust_poses_is_a_flag_of_its_own_scene(client: TestClient) -> None:
    plain, trusting = post(client), post(client, trust_poses="true")
    assert trusting.status_code == 201
    assert trusting.json()["id"] != plain.json()["id"]
    refused = post(client, trust_poses="perhaps")
    assert refused.status_code == 422
    assert refused.json()["field"] == "trust_poses"


def test_refine_poses_is_a_flag_of_its_own_scene(client: TestClient) -> None:
    plain, refined = post(client), post(client, refine_poses="true")
    assert refined.status_code == 201
    assert refined.json()["id"] != plain.json()["id"]
    assert post(client, refine_poses="perhaps").json()["field"] == "refine_poses"


def test_a_budget_belongs_to_the_scene(client: TestClient) -> None:
    """Other budgets and other certified views are other scenes; where nothing may go, views certify nothing."""
    default = post(client).json()
    assert default["pruning"]["max_error"] == pytest.approx(1 / 255)
    assert post(client, max_error="1/255", certify="1").json()["id"] == default["id"]
    whole = post(client, max_error="off").json()
    assert whole["pruning"]["dropped"] == 0
    assert whole["gaussians"]["count"] >= default["gaussians"]["count"]
    assert post(client, max_error="off", certify="4", views="0.5").json()["id"] == whole["id"]
    exact = post(client, max_error="0", certify="2", views="orbit:10").json()
    assert exact["pruning"]["certified"] == {"inputs": 2, "between": 2, "asked": 1}
    assert exact["pruning"]["bound"] == 0
    other = [post(client, **{name: value}).json()["id"] for name, value in (("stride", "2"), ("min_opacity", "0.1"))]
    assert len({default["id"], whole["id"], exact["id"], *other}) == 5
    swapped = [post(client, views=views).json()["id"] for views in ("0.5,1", "1,0.5,1")]
    assert swapped[0] == swapped[1]


def test_detail_belongs_to_the_scene_and_to_its_pictures(client: TestClient) -> None:
    """Pictures of a finer scene have its size, unless another is asked for."""
    plain, fine = (post(client, **fields).json() for fields in ({}, {"detail": "2"}))
    assert post(client, detail="1").json()["id"] == plain["id"] != fine["id"]
    assert [plain["detail"], fine["detail"]] == [1, 2]
    width, height = (2 * plain["view_cameras"][0][name] for name in ("width", "height"))
    assert (fine["view_cameras"][0]["width"], fine["view_cameras"][0]["height"]) == (width, height)
    answer = client.get("/render", params={"scene": fine["id"], "view": "0.5"})
    assert Image.open(io.BytesIO(answer.content)).size == (width, height)


def test_a_service_may_allow_no_more_detail(standin_model: Path, tmp_path: Path) -> None:
    limited = Settings(model=standin_model, store=tmp_path / "scenes", threads=1, max_detail=1)
    with TestClient(create_app(limited)) as other:
        wait_until_ready(other)
        body = assert_problem(post(other, detail="2"), 422, "invalid_input", "detail")
        assert body["detail"] == "is 2, the limit is 1"
        assert other.get("/models").json()["max_detail"] == 1
        assert post(other, detail="1").status_code == 201


def test_how_many_foretell_belongs_to_the_scene_where_it_changes_it(client: TestClient) -> None:
    """Two photographs foretell none, and of three no more than two can foretell the third."""
    two, three = [photograph(k) for k in (80, 81)], [photograph(k) for k in (80, 81, 82)]
    ids = {
        (len(images), text): post(client, images, leave_one_out=text)
        for images in (two, three)
        for text in ("0", "2", "5")
    }
    documents = {key: answer.json() for key, answer in ids.items()}
    assert len({documents[2, text]["id"] for text in ("0", "2", "5")}) == 1
    assert documents[3, "2"]["id"] == documents[3, "5"]["id"] == post(client, three).json()["id"]
    assert documents[3, "0"]["id"] != documents[3, "2"]["id"]
    assert documents[3, "0"]["check"]["leave_one_out"] is None
    assert [row["from"] for row in documents[3, "2"]["check"]["leave_one_out"]] == [[1, 2], [0, 2], [0, 1]]


@pytest.mark.parametrize(
    ("fields", "field"),
    [
        ({"max_error": "much"}, "max_error"),
        ({"max_error": "2"}, "max_error"),
        ({"max_error": "1/0"}, "max_error"),
        ({"certify": "-1"}, "certify"),
        ({"certify": "31"}, "certify"),
        ({"leave_one_out": "1"}, "leave_one_out"),
        ({"leave_one_out": "6"}, "leave_one_out"),
        ({"leave_one_out": "true"}, "leave_one_out"),
        ({"leave_one_out": "2.0"}, "leave_one_out"),
        ({"leave_one_out": "-2"}, "leave_one_out"),
        ({"fade": "9"}, "fade"),
        ({"fade": "-1"}, "fade"),
        ({"fade": "1.5"}, "fade"),
        ({"certify": "1.5"}, "certify"),
        ({"stride": "3"}, "stride"),
        ({"detail": "3"}, "detail"),
        ({"detail": "0"}, "detail"),
        ({"detail": "2.0"}, "detail"),
        ({"detail": "2", "stride": "2"}, "detail"),
        ({"min_opacity": "-1"}, "min_opacity"),
        ({"min_opacity": "nan"}, "min_opacity"),
    ],
)
def test_a_budget_that_makes_no_sense_is_refused(client: TestClient, fields: dict[str, str], field: str) -> None:
    assert_problem(post(client, **fields), 422, "invalid_input", field)


def test_fading_belongs_to_the_scene(client: TestClient) -> None:
    default, asked, none = post(client).json(), post(client, fade="4").json(), post(client, fade="0").json()
    assert default["id"] == asked["id"] != none["id"]
    assert default["fading"]["passes"] == 4
    assert none["fading"]["passes"] == none["fading"]["halved"] == 0
    before, after = default["fading"]["mean_opacity"]
    assert none["fading"]["mean_opacity"] == [before, before]
    assert after <= before
