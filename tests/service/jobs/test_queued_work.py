"""Work of a job: it comes back from disk to the bit, and its scene has an id of what it depends on alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from job_place import work

from gapmes.service.jobs.spool import Spool
from gapmes.service.jobs.work import Work


def test_work_comes_back_from_disk_to_the_bit(tmp_path: Path) -> None:
    given, spool = work(), Spool(tmp_path / "jobs")
    spool.put("1", given)
    found = spool.get("1")
    assert found.document() == given.document()
    assert found.images == given.images
    assert found.budget == given.budget
    assert found.scene_id("model") == given.scene_id("model")
    for one, two in zip(found.cameras, given.cameras, strict=True):
        assert one.world_from_cam.tobytes() == two.world_from_cam.tobytes()
        assert one.given == two.given
    assert found.model == given.model
    spool.drop("1")
    with pytest.raises(FileNotFoundError):
        spool.get("1")


def test_a_scene_is_the_same_whatever_file_its_poses_come_from() -> None:
    """But not where they were more precise; and what was queued without a word on the file is read."""
    one = work()

    def of(**changed: object) -> str:
        cameras = (replace(camera, given=camera.given._replace(**changed)) for camera in one.cameras)
        return replace(one, cameras=tuple(cameras)).scene_id("model")

    assert of(form="transforms.json", axes="opengl", pose="c2w") == one.scene_id("model")
    assert len({of(**{name: 0.5}) for name in ("drift", "shift", "step")} | {one.scene_id("model")}) == 4
    document = one.document()
    for entry in document["cameras"]:
        entry["given"] = entry["given"][:3]
    found = Work.of_document(document, one.images)
    assert [camera.given.form for camera in found.cameras] == ["", ""]
    assert found.scene_id("model") == one.scene_id("model")
