"""File names pair photographs with cameras, belong to their request, and may contain anything."""

from __future__ import annotations

import json
from typing import Any

import pytest
from http_requests import camera_object, photograph, post
from starlette.testclient import TestClient


@pytest.fixture(autouse=True)
def emptied(client: TestClient) -> None:
    for scene in client.get("/scenes").json()["scenes"]:
        client.delete(scene["links"]["self"])


def named(*names: str) -> dict[str, Any]:
    cameras = camera_object(len(names))
    for view, name in zip(cameras["views"], names, strict=True):
        view["image"] = f"images/{name}"
    return cameras


def centres(body: dict[str, Any]) -> list[float]:
    return [camera["c2w"][0][3] for camera in body["cameras"]]


def test_cameras_are_matched_by_name(client: TestClient) -> None:
    cameras = named("a.png", "b.png", "c.png", "d.png")
    body = post(client, cameras=cameras, names=["C.png", "b.png"]).json()
    assert centres(body) == pytest.approx([0.4, 0.2])
    assert body["paired_by"] == "name"
    assert body["images"] == ["C.png", "b.png"]


def test_what_browsers_write_for_quotes_and_line_ends_in_a_name_is_read_so(client: TestClient) -> None:
    cameras = named('12".png', "a\r\n.png", "b%22.png")
    body = post(client, cameras=cameras, names=["a%0D%0A.png", "12%22.png"]).json()
    assert centres(body) == pytest.approx([0.2, 0.0])
    assert body["paired_by"] == "name"
    body = post(client, cameras=cameras, names=["12%22.png", "b%22.png"]).json()  # a file may be named so, too
    assert centres(body) == pytest.approx([0.0, 0.4])


def test_cameras_of_other_names_are_matched_by_order_and_it_is_said(client: TestClient) -> None:
    body = post(client, cameras=named("a.png", "b.png"), names=["x.png", "y.png"]).json()
    assert centres(body) == [0.0, 0.2]
    assert body["paired_by"] == "order"
    assert any(warning["code"] == "names_differ" for warning in body["warnings"])


def test_order_does_not_give_an_image_to_another_camera_than_the_one_that_names_it(client: TestClient) -> None:
    answer = post(client, cameras=named("a.png", "b.png"), names=["b.png", "c.png"])
    assert answer.status_code == 422
    problem = answer.json()
    assert (problem["field"], problem["index"]) == ("images", 0)
    assert "'b.png' is named by camera 1, and by order would get camera 0, which names 'images/a.png'" in answer.text
    assert post(client, cameras=named("a.png", "b.png"), names=["x.png", "b.png"]).json()["paired_by"] == "order"


THREE = [photograph(index) for index in range(3)]


def test_folders_tell_equal_names_apart(client: TestClient) -> None:
    cameras = named("left/0.png", "right/0.png", "left/1.png")
    body = post(client, THREE, cameras=cameras, names=["right/0.png", "left/0.png", "left/1.png"]).json()
    assert body["paired_by"] == "name"
    assert centres(body) == [0.2, 0.0, 0.4]
    assert all(warning["code"] != "names_differ" for warning in body["warnings"])
    for other in ("here/left/0.png", "images/left/0.png"):
        assert post(client, THREE, cameras=cameras, names=["right/0.png", other, "1.png"]).json()["paired_by"] == "name"


def test_names_of_some_cameras_contradict_an_order_too(client: TestClient) -> None:
    cameras = named("a.png", "b.png", "c.png")
    del cameras["views"][2]["image"]
    for names, said in (
        (["b.png", "a.png", "c.png"], "by order would get camera 0, which names 'images/a.png'"),
        (["x.png", "y.png", "a.png"], "by order would get camera 2, which names none"),
    ):
        answer = post(client, THREE, cameras=cameras, names=names)
        assert answer.status_code == 422
        assert said in answer.text
    right, other = (
        post(client, THREE, cameras=cameras, names=names) for names in (["a.png", "b.png", "z.png"], list("xyz"))
    )
    assert [answer.json()["paired_by"] for answer in (right, other)] == ["order", "order"]
    codes = [[warning["code"] for warning in answer.json()["warnings"]] for answer in (right, other)]
    assert ["names_differ" in each for each in codes] == [False, True]


def test_an_image_that_was_sent_twice_is_named(client: TestClient) -> None:
    problem = post(
        client, THREE, cameras=named("a.png", "b.png", "c.png", "d.png"), names=["a.png", "b.png", "a.png"]
    ).json()
    assert (problem["field"], problem["index"]) == ("images", 2)
    assert "4 cameras for 3 images, and 'a.png' is the image of camera 0, as image 0 is" in problem["detail"]


def test_a_second_client_gets_its_own_names(client: TestClient) -> None:
    """The same photographs and cameras under other names: one scene, and no name of the first client's in an answer."""
    first = post(client, cameras=named("secret_a.png", "secret_b.png"), names=["secret_a.png", "secret_b.png"])
    second = post(client, cameras=named("a.png", "b.png"), names=["x.png", "y.png"])
    assert (first.status_code, second.status_code) == (201, 200)
    assert second.json()["id"] == first.json()["id"]
    assert (first.json()["paired_by"], second.json()["paired_by"]) == ("name", "order")
    assert second.json()["images"] == ["x.png", "y.png"]
    assert [warning["code"] for warning in second.json()["warnings"]].count("names_differ") == 1
    assert all(warning["code"] != "names_differ" for warning in first.json()["warnings"])
    for answer in (second, client.get(first.headers["location"]), client.get("/scenes")):
        assert "secret" not in answer.text


@pytest.mark.parametrize("charset", ["unicode_escape", "utf-7"])
def test_names_that_utf_8_cannot_hold_are_escaped(client: TestClient, charset: str) -> None:
    """A lone surrogate in a file name: the scene is stored and the answer is strict UTF-8 JSON."""
    good = client.build_request("POST", "/reconstruct", files=parts_named("NAME.png", "1.png"))
    kind = good.headers["content-type"].replace("form-data;", f"form-data; charset={charset};")
    name = {"unicode_escape": rb"\ud800.png", "utf-7": b"+2AA-.png"}[charset]
    answer = client.post("/reconstruct", content=good.read().replace(b"NAME.png", name), headers={"content-type": kind})
    assert answer.status_code == 201, answer.text
    assert answer.json()["images"] == [r"\ud800.png", "1.png"]
    json.dumps(answer.json(), ensure_ascii=False).encode()


def parts_named(*names: str) -> list[Any]:
    parts: list[Any] = [("images", (name, photograph(index))) for index, name in enumerate(names)]
    return [*parts, ("cameras", ("cameras.json", json.dumps(camera_object(len(names))).encode()))]


def test_names_that_occur_twice_settle_nothing(client: TestClient) -> None:
    body = post(client, cameras=named("a.png", "a.png"), names=["a.png", "a.png"]).json()
    assert body["paired_by"] == "order"
    assert all(warning["code"] != "names_differ" for warning in body["warnings"])


def test_cameras_that_no_image_belongs_to_are_never_parsed(client: TestClient) -> None:
    """Each lens costs milliseconds to invert; a file may list two thousand."""
    cameras = named("a.png", "b.png", "c.png")
    cameras["views"][2]["fx"] = "no number"
    assert post(client, cameras=cameras, names=["b.png", "a.png"]).status_code in (200, 201)
    refused = post(client, cameras=cameras, names=["c.png", "a.png"]).json()
    assert (refused["field"], refused["index"]) == ("views.fx", 2)
