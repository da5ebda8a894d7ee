"""`gapmes render --path inputs`: a film passes through the views in the given order, also repeatedly."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cli_runs import run
from clouds import cloud
from test_film import decoded

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.camera_file import camera_document
from gapmes.service.formats.ply import read_ply, write_ply
from gapmes.service.pictures.effort import draw
from gapmes.service.pictures.picture_error import psnr
from gapmes.service.viewpoints.camera_path import loop
from gapmes.service.viewpoints.scene_views import SceneViews


def test_a_path_meets_a_view_as_often_as_it_is_named(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """0, 2, 0, 1 and not 0, 2, 1. At worst 32.9 dB; of the shorter path some frame has 14.4. A folder of pictures has
    each once."""
    write_ply(tmp_path / "scene.ply", cloud(300, 3, degree=0))
    cameras = []
    for index in range(3):
        pose = np.eye(4)
        pose[0, 3] = 0.2 * index
        cameras.append(Camera.make(96, 64, 80.0, 80.0, 48.0, 32.0, pose))
    document = {"near": 1.0, "far": 10.0, "views": [camera_document(camera) for camera in cameras]}
    (tmp_path / "cameras.json").write_text(json.dumps(document))
    common = (tmp_path / "scene.ply", "--cameras", tmp_path / "cameras.json", "--threads", 1, "--views", "0,2,0,1")
    film = tmp_path / "film.webp"
    assert run("render", *common, "-o", film, "--path", "inputs", "--seconds", 1, "--fps", 10) == 0
    views, gaussians = SceneViews([cameras[index] for index in (0, 2, 0, 1)], 1.0, 10.0), read_ply(common[0])
    found = decoded(film)
    assert len(found) == 10
    for picture, camera in zip(found, loop(views.path("inputs"), 10), strict=True):
        expected = draw(gaussians, camera, threads=1, **views.near_plane).rgb8()
        assert psnr(picture, expected) > 25.5
    assert run("render", *common, "-o", tmp_path / "pictures") == 0
    assert sorted(path.name for path in (tmp_path / "pictures").iterdir()) == ["view_0.png", "view_1.png", "view_2.png"]
