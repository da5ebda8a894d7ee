"""Points of COLMAP models over HTTP: the depth range that they give, and what is told of those that cannot be read."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import pycolmap
import pytest
from capture_scenes import arc, colmap_model, names, write_photographs, zipped
from http_requests import photograph
from starlette.testclient import TestClient


def model_with_points(root: Path) -> None:
    """Three photographs with points about 3 to 5 units before them, and a fourth without."""
    model = colmap_model(arc(4), names(4), features=60)
    ids = sorted(model.images)[:3]
    for place in range(60):
        track = pycolmap.Track([pycolmap.TrackElement(image_id, place) for image_id in ids])
        point = model.add_point3D([0.3, -0.2, 3.5 + place / 30], track)
        model.points3D[point].error = 1.0
    write_photographs(root / "images", names(4))
    (root / "sparse/0").mkdir(parents=True)
    model.write_binary(str(root / "sparse/0"))


def checked(client: TestClient, data: bytes, **fields: str) -> dict[str, Any]:
    parts: list[Any] = [("capture", ("c.zip", data))]
    parts += [(name, (None, value)) for name, value in fields.items()]
    answer = client.post("/check", files=parts)
    assert answer.status_code == 200, answer.text
    return answer.json()


def test_near_and_far_are_those_of_the_points(client: TestClient, tmp_path: Path) -> None:
    model_with_points(tmp_path)
    document = checked(client, zipped(tmp_path), select="0,1")
    assert document["depth_range_source"] == "given"
    assert 0.8 * 2.9 < document["near"] < 0.8 * 3.2
    assert 1.3 * 4.8 < document["far"] < 1.3 * 5.1
    given = checked(client, zipped(tmp_path), select="0,1", near="2")
    assert (given["near"], given["far"]) == (2.0, document["far"])


@pytest.mark.parametrize("data", [struct.pack("<Q", 2**40), b"cut"])
def test_points_that_cannot_be_read_are_told(client: TestClient, tmp_path: Path, data: bytes) -> None:
    model_with_points(tmp_path)
    (tmp_path / "sparse/0/points3D.bin").write_bytes(data)
    document = checked(client, zipped(tmp_path), select="0,1")
    assert document["depth_range_source"] == "cameras"
    (told,) = [each for each in document["warnings"] if each["code"] == "points_not_read"]
    assert told["field"] == "capture"
    model = [("cameras", ("model.zip", zipped(tmp_path / "sparse")))]
    parts = [("images", (Path(name).name, photograph(place))) for place, name in enumerate(names(4))]
    beside = client.post("/check", files=[*model, *parts])
    assert beside.status_code == 200, beside.text
    (told,) = [each for each in beside.json()["warnings"] if each["code"] == "points_not_read"]
    assert told["field"] == "cameras"
