"""Refusals name the members that the camera file has, and what each of them must be."""

from __future__ import annotations

import json

import numpy as np
import pytest
from camera_documents import our_file, transforms

from gapmes.service.cameras.camera_file import parse_camera_file
from gapmes.service.captures.recognise import table_of_bytes
from gapmes.service.errors import CameraError, IntrinsicsError, PoseError


@pytest.mark.parametrize(("name", "value"), [("width", 0), ("height", -480), ("height", 1234567.5), ("width", 2**31)])
def test_the_side_that_is_none_is_named(name: str, value: float) -> None:
    file = our_file()
    file["views"][1][name] = value
    with pytest.raises(
        CameraError, match=f"^views.{name}: {name} = {value}, need whole numbers from 1 to 2147483647"
    ) as caught:
        parse_camera_file(file)
    assert (caught.value.field, caught.value.index) == (f"views.{name}", 1)


@pytest.mark.parametrize(("name", "value"), [("w", 0), ("h", -480), ("h", 1234567.5), ("w", 2**31)])
def test_the_side_of_a_frame_is_named(name: str, value: float) -> None:
    with pytest.raises(CameraError, match=f"{name} = {value}, need whole numbers from 1 to 2147483647") as caught:
        parse_camera_file(transforms(**{name: value}))
    assert (caught.value.field, caught.value.index) == (f"frames.{name}", 0)
    assert caught.value.cure


@pytest.mark.parametrize(
    ("top", "field"),
    [
        ({"fl_x": 0.9, "fl_y": 500.0}, "fl_x"),
        ({"fl_x": 500.0, "fl_y": 1e9}, "fl_y"),
        ({"fl_x": 47.0}, "fl_x"),  # too short for the width
        ({"camera_angle_x": 0.9, "fl_y": -500.0}, "fl_y"),
        ({"camera_angle_x": 0.9, "cx": 1e9}, "cx"),
    ],
)
def test_a_focal_length_has_the_name_of_the_file(top: dict[str, float], field: str) -> None:
    file = {"w": 640, "h": 480, **top, "frames": transforms()["frames"]}
    with pytest.raises(IntrinsicsError) as caught:
        parse_camera_file(file)
    assert (caught.value.field, caught.value.index) == (f"frames.{field}", 0)


@pytest.mark.parametrize("angle", [0.0, 0.049, 2.75, 3.1, 52.0, -0.9])
def test_a_field_of_view_that_no_lens_has_is_named_as_such(angle: float) -> None:
    """Not as a focal length, which the file does not have."""
    file = {"w": 640, "h": 480, "camera_angle_x": angle, "frames": transforms()["frames"]}
    with pytest.raises(IntrinsicsError, match=f"camera_angle_x = {angle:g}, need between 0.05 and 2.75") as caught:
        parse_camera_file(file)
    assert (caught.value.field, caught.value.index) == ("frames.camera_angle_x", 0)


@pytest.mark.parametrize("value", [265.0, 1e9])
def test_a_focal_length_of_another_size_has_a_cure(value: float) -> None:
    file = our_file()
    file["views"][0] |= {"width": 6400, "height": 4800, "fx": value}
    with pytest.raises(IntrinsicsError) as caught:
        parse_camera_file(file)
    assert caught.value.cure == "give it in px of a picture of this very size: it grows with the picture"


@pytest.mark.parametrize("entry", ["1", "1e0", True, np.True_, np.str_("1"), b"1"])
@pytest.mark.parametrize("pose", ["c2w", "w2c"])
def test_text_and_truth_values_are_no_numbers_of_a_pose(entry: object, pose: str) -> None:
    """As of focal lengths: numpy would read them."""
    file = our_file() | {"pose": pose}
    file["views"][1]["c2w"] = [[entry, 0, 0, 0.3], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    with pytest.raises(PoseError, match="need numbers") as caught:
        parse_camera_file(file)
    assert (caught.value.field, caught.value.index) == ("views.c2w", 1)
    assert ("quotation marks" in (caught.value.cure or "")) == isinstance(entry, str | bytes)


def test_a_member_that_is_there_twice_is_refused() -> None:
    text = json.dumps(our_file()).replace('"near"', '"near": 2.0, "near"', 1)
    with pytest.raises(CameraError) as caught:
        table_of_bytes(text.encode(), "cameras.json")
    assert caught.value.message == "cameras.json has 'near' 2 times in one object, need it once"
    assert (caught.value.field, caught.value.cure) == ("cameras", "keep the one that is meant")
