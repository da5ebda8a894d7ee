"""Arguments of `Camera.make` in Python: any numeric type, and refusals by field and index of all else."""

import numpy as np
import pytest

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.camera_json import camera_from_json
from gapmes.service.errors import CameraError, IntrinsicsError, PoseError

GIVEN = {"width": 512, "height": 384, "fx": 500.0, "fy": 510.0, "cx": 256.0, "cy": 192.0, "world_from_cam": np.eye(4)}


def test_numbers_of_numpy_make_the_same_camera() -> None:
    given = {"width": np.int64(512), "height": np.float32(384), "fx": np.float32(500), "fy": np.array(510), "cx": 256}
    camera, expected = Camera.make(**{**GIVEN, **given}), Camera.make(**GIVEN)
    for name in ("width", "height", "fx", "fy", "cx", "cy"):
        value = getattr(camera, name)
        assert type(value) is type(getattr(expected, name))
        assert value == getattr(expected, name)


@pytest.mark.parametrize("value", ["500", None, 1j, True, [500.0], np.array([500.0]), np.complex64(500)])
@pytest.mark.parametrize("name", ["fx", "fy", "cx", "cy"])
def test_intrinsics_that_are_no_numbers_are_refused(name: str, value: float) -> None:
    with pytest.raises(IntrinsicsError, match="need a finite number") as caught:
        Camera.make(**{**GIVEN, name: value}, index=3)
    assert (caught.value.field, caught.value.index) == (f"camera.{name}", 3)
    assert caught.value.message.startswith(f"{name} = {value!r}"[:20])


def test_a_whole_number_beyond_float64_is_refused() -> None:
    with pytest.raises(IntrinsicsError, match="fx = inf, need a finite number"):
        Camera.make(**{**GIVEN, "fx": 10**400})


@pytest.mark.parametrize("value", ["512", None, 1j, True, 512.5, 0, 10**400, np.array([512])])
def test_sides_that_are_no_whole_numbers_are_refused(value: float) -> None:
    with pytest.raises(CameraError, match="need whole numbers from 1 to") as caught:
        Camera.make(**{**GIVEN, "width": value}, index=1)
    assert (caught.value.field, caught.value.index) == ("camera.width", 1)


def test_another_size_of_a_camera_is_checked_like_its_own() -> None:
    camera = Camera.make(**GIVEN)
    for other in (camera.resized(camera.width / 2, np.float32(192)), camera.cropped(3, 4, 256.0, np.int64(192))):
        assert (other.width, other.height) == (256, 192)
        assert type(other.width) is type(other.height) is int
    for wrong in (100.5, 0, -3, "100"):
        for name, sides in (("width", (wrong, 75)), ("height", (100, wrong))):
            for make in (camera.resized, lambda width, height: camera.cropped(0, 0, width, height)):
                with pytest.raises(CameraError, match=f"{name} = .*, need whole numbers from 1 to") as caught:
                    make(*sides)
                assert caught.value.field == f"camera.{name}"


@pytest.mark.parametrize(
    ("value", "kind"), [([1.0], "a list"), ("x", "a text"), (None, "null"), (True, "true or false")]
)
def test_a_camera_of_json_is_an_object(value: object, kind: str) -> None:
    with pytest.raises(CameraError, match=f"is {kind}, need an object") as caught:
        camera_from_json(value)
    assert caught.value.field == "camera"


@pytest.mark.parametrize("pose", [np.eye(4, dtype=complex), [[1j, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]])
def test_a_pose_of_complex_numbers_is_refused(pose: object) -> None:
    """No imaginary part is dropped, not even one of rounding."""
    with pytest.raises(PoseError, match="holds complex numbers, need real ones") as caught:
        Camera.make(**{**GIVEN, "world_from_cam": pose}, index=2)
    assert (caught.value.field, caught.value.index) == ("camera.c2w", 2)


@pytest.mark.parametrize("pose", [[[str(n) for n in row] for row in np.eye(4)], np.eye(4).astype("S3"), [["0", 1.0]]])
def test_a_pose_of_text_is_refused_like_a_focal_length_of_text(pose: object) -> None:
    with pytest.raises(PoseError, match=r"holds .*, need numbers \(write numbers without quotation marks"):
        Camera.make(64, 64, 64, 64, 32, 32, pose)
