"""The views of a scene: its cameras to the number, its pivot and the plane at which pictures begin."""

from __future__ import annotations

import numpy as np
import pytest

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.camera_file import camera_document
from gapmes.service.viewpoints.scene_views import SceneViews

POSE = np.array([[0.0, -1.0, 0.0, 4.0], [1.0, 0.0, 0.0, 5.0], [0.0, 0.0, 1.0, 6.0], [0.0, 0.0, 0.0, 1.0]])


def test_cameras_of_a_document_are_those_that_it_tells() -> None:
    """Also of a crop whose principal point lies far outside."""
    camera = Camera.make(64, 48, 50.0, 40.0, 30.0, 20.0, POSE).cropped(500, -70, 32, 16)
    views = SceneViews.of_document({"view_cameras": [camera_document(camera)] * 2, "near": 2.0, "far": 8.0})
    assert (len(views.cameras), views.near, views.far) == (2, 2.0, 8.0)
    found = views.cameras[1]
    assert [getattr(found, name) for name in ("width", "height", "fx", "fy", "cx", "cy")] == [32, 16, 50, 40, -470, 90]
    np.testing.assert_array_equal(found.world_from_cam, POSE)


@pytest.mark.parametrize(
    ("near", "far", "pivot", "plane"),
    [(2.0, 8.0, 4.0, {"near": 0.2}), (2.0, None, 1.0, {"near": 0.2}), (None, 8.0, 1.0, {}), (None, None, 1.0, {})],
)
def test_the_pivot_is_the_geometric_mean_and_pictures_begin_at_a_tenth_of_near(
    near: float | None, far: float | None, pivot: float, plane: dict[str, float]
) -> None:
    views = SceneViews([Camera.make(64, 48, 50.0, 40.0, 30.0, 20.0, POSE)], near, far)
    assert views.pivot_depth == pytest.approx(pivot)
    assert views.near_plane == pytest.approx(plane)
