"""Values of a camera file that are nested as deeply as JSON may be."""

import json

import pytest
from camera_documents import our_file

from gapmes.service.cameras.camera_file import parse_camera_file
from gapmes.service.errors import CameraError


@pytest.mark.parametrize("name", ["k1", "distortion", "skew", "near", "fx", "image", "axes"])
def test_values_as_deep_as_json_may_be_are_refused_like_others(name):
    """The text of a refusal has the beginning alone."""
    file = json.loads(json.dumps(our_file()))
    file["views"][1][name] = json.loads("[" * 600 + "]" * 600)
    with pytest.raises(CameraError, match=rf"{name}.*\[\[\[") as caught:
        parse_camera_file(file)
    assert caught.value.index == 1
    assert len(str(caught.value)) < 300
