"""`gapmes reconstruct --refine-poses`."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from cli_runs import reconstruct
from sample_photographs import FAR, NEAR, sample_cameras
from wrong_cameras import turned_camera

from gapmes.service.cameras.camera_file import camera_document
from gapmes.service.shipped import sample_folder


def test_poses_that_are_slightly_wrong_are_refined(
    tmp_path: Path, standin_model: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "scene"
    shutil.copytree(sample_folder(), folder)
    first, second = sample_cameras((1, 3))
    views = [camera_document(camera) for camera in (first, turned_camera(second, (1, 0, 0), 0.7))]
    named = [{**view, "image": f"images/{i:03d}.png"} for view, i in zip(views, (1, 3), strict=True)]
    (folder / "cameras.json").write_text(json.dumps({"near": NEAR, "far": FAR, "views": named}))
    for more, code in (((), "poses_inexact"), (("--refine-poses",), "poses_refined")):
        assert reconstruct(folder, standin_model, *more, "--json") == 0
        document = json.loads(capfd.readouterr().out)
        assert [warning["code"] for warning in document["warnings"]] == [code]
    given, used = (document[name][1]["c2w"] for name in ("cameras", "view_cameras"))
    np.testing.assert_allclose(given, views[1]["c2w"], atol=1e-12)
    np.testing.assert_allclose(used, second.world_from_cam, atol=5e-3)  # of 64 px; it was off by 0.012
