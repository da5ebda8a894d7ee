"""Scenes damaged from outside, over HTTP: refused by name, deleted, or made again on request."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from http_requests import assert_problem, photograph, post
from served_process import until
from starlette.testclient import TestClient

from gapmes.service.settings import Settings

PHOTOGRAPHS = [photograph(70), photograph(71)]
DAMAGES: dict[str, tuple[Callable[[Path], object], int, str]] = {
    "empty document": (lambda folder: (folder / "scene.json").write_bytes(b""), 422, "format_invalid"),
    "half a document": (lambda folder: (folder / "scene.json").write_bytes(b'{"id": '), 422, "format_invalid"),
    "no Gaussians": (lambda folder: (folder / "scene.ply").unlink(), 404, "scene_not_found"),
}


@pytest.fixture(params=DAMAGES.values(), ids=DAMAGES)
def damaged(client: TestClient, settings: Settings, request: pytest.FixtureRequest) -> tuple[dict[str, Any], int, str]:
    """A scene, damaged, and how it is refused."""
    damage, status, code = request.param
    scene = post(client, PHOTOGRAPHS).json()
    damage(settings.store / scene["id"])
    return scene, status, code


Damaged = tuple[dict[str, Any], int, str]


def test_it_is_refused_by_name_and_can_be_deleted(client: TestClient, damaged: Damaged) -> None:
    scene, status, code = damaged
    for path in (scene["links"]["self"], scene["links"]["views"][0], scene["links"]["preview"]):
        assert scene["id"] in assert_problem(client.get(path), status, code, "scene", cured=True)["detail"]
    assert client.delete(scene["links"]["self"]).status_code == 204
    assert_problem(client.get(scene["links"]["self"]), 404, "scene_not_found")
    assert scene["id"] not in [row["id"] for row in client.get("/scenes").json()["scenes"]]


def test_where_its_document_alone_is_damaged_its_files_are_sent(client: TestClient, settings: Settings) -> None:
    scene = post(client, PHOTOGRAPHS).json()
    (settings.store / scene["id"] / "scene.json").write_bytes(b"")
    for path in (*scene["links"]["files"].values(), *scene["links"]["inputs"]):
        assert client.get(path).status_code == 200
    assert client.delete(scene["links"]["self"]).status_code == 204


def test_who_asks_again_gets_it_anew(client: TestClient, damaged: Damaged) -> None:
    scene, _, _ = damaged
    again = post(client, PHOTOGRAPHS)
    assert (again.status_code, again.json()["id"]) == (201, scene["id"])
    for path in (again.json()["links"]["ply"], *again.json()["links"]["views"], *again.json()["links"]["inputs"]):
        assert client.get(path).status_code == 200
    assert post(client, PHOTOGRAPHS).status_code == 200


def test_files_of_another_user_are_damage(
    client: TestClient, settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As after a backup was put back by root."""
    scene = post(client, PHOTOGRAPHS).json()
    folder = settings.store / scene["id"]
    may_access, may_open, may_read = os.access, os.open, Path.read_bytes

    def refuse(path: object) -> None:
        if str(path) in (str(folder / "scene.ply"), str(folder / "input_0.png")):
            raise PermissionError(errno.EACCES, "Permission denied")

    def access(path: Any, mode: int) -> bool:
        return str(path) != str(folder / "scene.ply") and may_access(path, mode)

    with monkeypatch.context() as denied:
        denied.setattr(os, "access", access)
        denied.setattr(os, "open", lambda path, *more, **options: refuse(path) or may_open(path, *more, **options))
        denied.setattr(Path, "read_bytes", lambda path: refuse(path) or may_read(path))
        for path in (*scene["links"]["files"].values(), *scene["links"]["views"], scene["links"]["self"]):
            problem = assert_problem(client.get(path), 422, "format_invalid", "scene", cured=True)
            assert problem["detail"].endswith("scene.ply cannot be read: Permission denied")
        problem = assert_problem(client.get(scene["links"]["inputs"][0]), 422, "format_invalid", "scene", cured=True)
        assert problem["detail"].endswith("input_0.png cannot be read: Permission denied")
    assert client.get(scene["links"]["ply"]).status_code == 200


def test_a_job_makes_it_anew_too(client: TestClient, damaged: Damaged) -> None:
    scene, _, _ = damaged
    job = post(client, PHOTOGRAPHS, prefer="respond-async").json()
    until(lambda: client.get(job["links"]["self"]).json()["state"] == "done")
    assert client.get(job["links"]["self"]).json()["started"] is not None
    assert client.get(scene["links"]["self"]).json()["id"] == scene["id"]


def test_a_picture_without_a_scene_shows_one_that_is_whole(client: TestClient, settings: Settings) -> None:
    whole, newer = post(client, [photograph(72), photograph(73)]), post(client, [photograph(74), photograph(75)])
    (settings.store / newer.json()["id"] / "scene.ply").unlink()
    assert client.get("/render?view=0").content == client.get(whole.json()["links"]["views"][0]).content
    assert client.delete(newer.json()["links"]["self"]).status_code == 204


def test_a_file_is_loaded_anew(client: TestClient, settings: Settings) -> None:
    ply = client.get(post(client, PHOTOGRAPHS).json()["links"]["ply"]).content
    headers = {"Content-Type": "application/octet-stream"}
    scene = client.post("/scenes", content=ply, headers=headers).json()
    (settings.store / scene["id"] / "scene.json").write_bytes(b"")
    assert client.post("/scenes", content=ply, headers=headers).status_code == 201
    assert client.get(scene["links"]["views"][0]).status_code == 200
