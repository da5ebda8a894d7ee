"""Depth bounds from COLMAP's points: pycolmap computes the depths that they are compared with."""

from __future__ import annotations

import io
import struct
import threading
import zipfile
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pycolmap
import pytest
from capture_scenes import arc, names, write_photographs
from capture_scenes import colmap_model as model_of
from hostile import archive_of, opened, peak_below

from gapmes.service.cameras.depth_range import depth_range
from gapmes.service.captures import colmap_binary, colmap_model, colmap_points, colmap_text
from gapmes.service.captures.capture import open_capture
from gapmes.service.captures.colmap_model import (
    IDENTITY,
    MAX_POINTS,
    ColmapFrame,
    ColmapImage,
    ColmapModel,
    Points,
)
from gapmes.service.captures.colmap_points import (
    BEFORE,
    BEYOND,
    LARGEST,
    MIN_POINTS,
    SMALLEST,
    DepthBounds,
    depth_bounds,
)
from gapmes.service.captures.files import FolderFiles
from gapmes.service.captures.select import ViewSelection
from gapmes.service.errors import CameraError

POINT = struct.Struct("<Q3d3BdQ")


def model_with_points(seed: int, count: int = 400, views: int = 5) -> pycolmap.Reconstruction:
    """Points at depths of 2 to 9, each seen by some views; errors up to 3 px. The first view by name has too few."""
    rng, model = np.random.default_rng(seed), model_of(arc(views), names(views), features=count)
    ids = sorted(model.images)
    for place in range(count):
        few = place < MIN_POINTS - 1
        among = ids if few else ids[:-1]
        track = ids if few else rng.choice(among, size=int(rng.integers(2, len(among) + 1)), replace=False)
        elements = [pycolmap.TrackElement(int(image_id), place) for image_id in track]
        point_id = model.add_point3D(rng.uniform([-1.0, -1.0, -2.0], [1.0, 1.0, 5.0]), pycolmap.Track(elements))
        model.points3D[point_id].error = float(rng.uniform(0, 3))
    return model


def expected(model: pycolmap.Reconstruction, image_id: int) -> tuple[float, float] | None:
    """By the definition, point by point."""
    image = model.images[image_id]
    depths = []
    for point in model.points3D.values():
        views = {element.image_id for element in point.track.elements}
        if image_id in views and len(views) >= 3 and point.error <= 2.0:
            depth = (image.cam_from_world() * point.xyz)[2]
            if depth > 0:
                depths.append(depth)
    if len(depths) < 20:
        return None
    return 0.8 * float(np.percentile(depths, 1)), 1.3 * float(np.percentile(depths, 99))


def pairs(points: Points) -> list[tuple[int, int]]:
    """Images' ids, and places of the points that they were matched in."""
    return [divmod(pair, 2**32) for pair in points.seen.tolist()]


def written(root: Path, model: pycolmap.Reconstruction, *, text: bool = False) -> Path:
    write_photographs(root / "images", [image.name for image in model.images.values()])
    (root / "sparse/0").mkdir(parents=True)
    (model.write_text if text else model.write_binary)(str(root / "sparse/0"))
    return root


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_bounds_are_those_of_the_points_of_each_view(tmp_path: Path, seed: int, text: bool) -> None:
    model = model_with_points(seed)
    capture = open_capture(written(tmp_path, model, text=text))
    by_name = {image.name: image_id for image_id, image in model.images.items()}
    wanted = [expected(model, by_name[str(name)]) for name in capture.names]
    found = [view.bounds for view in capture.cameras(range(5)).views]
    assert [bounds is None for bounds in found] == [bounds is None for bounds in wanted]
    assert found.count(None) == 1
    for ours, theirs in zip(found, wanted, strict=True):
        if ours is not None:
            assert ours == pytest.approx(theirs, rel=1e-9)


def test_near_and_far_are_those_of_the_chosen_views(tmp_path: Path) -> None:
    capture = open_capture(written(tmp_path, model_with_points(7)))
    chosen = capture.choose(ViewSelection("1,2"))
    bounds = [view.bounds for view in capture.cameras([1, 2]).views]
    assert all(each is not None for each in bounds)
    ends = np.array(bounds)
    assert (chosen.file.near, chosen.file.far) == (ends[:, 0].min(), ends[:, 1].max())
    assert chosen.checked_depths(0.5, 60.0) == (0.5, 60.0)
    assert not chosen.warnings


def test_without_points_nothing_is_known(tmp_path: Path) -> None:
    root = written(tmp_path, model_with_points(1))
    (root / "sparse/0/points3D.bin").unlink()
    chosen = open_capture(root).choose(ViewSelection("1,2"))
    assert (chosen.file.near, chosen.file.far, chosen.warnings) == (None, None, ())


def test_points_of_unknown_error_count(tmp_path: Path) -> None:
    """COLMAP writes -1 where it has not computed the error."""
    model = model_with_points(2)
    for point in model.points3D.values():
        point.error = -1.0
    assert open_capture(written(tmp_path, model)).cameras([1]).near is not None


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda data: data[:-3], "points3D.bin ends after"),
        (lambda data: struct.pack("<Q", MAX_POINTS + 1) + data[8:], f"has {MAX_POINTS + 1} points, at most"),
        (lambda data: data[: 8 + 43] + struct.pack("<Q", 2**62) + data[8 + 51 :], "matches of points, at most"),
        (lambda data: b"", "points3D.bin ends after 0 bytes"),
    ],
)
def test_points_that_cannot_be_read_are_told_and_passed_over(tmp_path: Path, change, told: str) -> None:
    root = written(tmp_path, model_with_points(3))
    path = root / "sparse/0/points3D.bin"
    path.write_bytes(change(path.read_bytes()))
    chosen = open_capture(root).choose(ViewSelection("1,2"))
    assert (chosen.file.near, chosen.file.far) == (None, None)
    (warning,) = chosen.warnings
    assert warning["code"] == "points_not_read"
    assert told in warning["message"]


def test_points_that_are_not_finite_or_behind_do_not_count() -> None:
    """Of one point each at infinity, nowhere and behind, none makes a bound."""
    rows = [(np.inf, 0, 0), (np.nan, 0, 0), (0, 0, -9)]
    data = b"".join(POINT.pack(k, *xyz, 0, 0, 0, 1.0, 1) + struct.pack("<II", 4, 0) for k, xyz in enumerate(rows))
    points = colmap_binary.read_points(io.BytesIO(struct.pack("<Q", 3) + data), "a.bin")
    np.testing.assert_array_equal(points.xyz, rows)
    assert pairs(points) == [(4, 0), (4, 1), (4, 2)]


def test_texts_of_points_name_the_line() -> None:
    whole = "# comment\n\n7 1 2 3 0 0 0 0.5 4 0 9 1\n"
    points = colmap_text.read_points(io.BytesIO(whole.encode()), "a.txt")
    assert points.xyz.tolist() == [[1.0, 2.0, 3.0]]
    assert (points.error.tolist(), pairs(points)) == ([0.5], [(4, 0), (9, 0)])
    assert colmap_text.read_points(io.BytesIO(b""), "a.txt").xyz.shape == (0, 3)
    for line, told in (
        ("7 1 2 3 0 0 0 0.5 4", "a.txt, line 1: a point has 9 columns"),
        ("7 1 2 3 0 0 0", "a.txt, line 1: a point has 7 columns"),
        ("7 1 x 3 0 0 0 0.5", "a.txt, line 1: could not convert"),
        ("7 1 2 3 0 0 0 0.5 4294967296 0", "a.txt, line 1: an image's number"),
        ("7 1 2 3 0 0 0 0.5 -1 0", "a.txt, line 1: an image's number"),
        ("7 1 2 3 0 0 0 0.5" + 2**18 * " 4 0", "a.txt, line 1 has more than 1048576 bytes"),
    ):
        with pytest.raises(CameraError, match=told):
            colmap_text.read_points(io.BytesIO(line.encode()), "a.txt")


@pytest.mark.parametrize(
    ("limit", "told"), [("MAX_POINTS", "has 4 points, at most 3"), ("MAX_SEEN", "has 4 matches of points, at most 3")]
)
def test_texts_of_too_many_points_are_left(monkeypatch: pytest.MonkeyPatch, limit: str, told: str) -> None:
    monkeypatch.setattr(colmap_model, limit, 3)
    stream = io.BytesIO(5 * b"7 1 2 3 0 0 0 0.5 4 0\n")
    with pytest.raises(CameraError, match=told):
        colmap_text.read_points(stream, "a.txt")


def test_the_share_around_the_points_is_as_documented() -> None:
    assert (BEFORE, BEYOND, MIN_POINTS) == (0.8, 1.3, 20)


def test_views_of_a_point_count_once(tmp_path: Path) -> None:
    """COLMAP may match one image in a point twice: two views stay two."""
    model = model_with_points(4, views=3)
    for point in model.points3D.values():
        point.error = 0.5
        point.track.add_element(point.track.elements[0].image_id, 399)
    assert [view.bounds for view in open_capture(written(tmp_path, model)).cameras(range(3)).views] == [None] * 3


@pytest.mark.parametrize("form", ["bin", "txt"])
def test_a_match_takes_few_bytes(form: str) -> None:
    """Of as many as are read 77 bytes for each would take 770 MB, sent in a zip of less than 1 MB."""
    count, track = 5_000, range(70_000, 70_040)
    if form == "bin":
        matches = b"".join(struct.pack("<II", image, 0) for image in track)
        data = struct.pack("<Q", count) + count * (POINT.pack(1, 0, 0, 5, 0, 0, 0, 1.0, len(track)) + matches)
    else:
        data = count * f"1 0 0 5 0 0 0 1 {' '.join(f'{image} 0' for image in track)}\n".encode()
    model = ColmapModel(images={image: ColmapImage("a", 1, IDENTITY) for image in track})
    with peak_below(32 * count * len(track)):
        found = depth_bounds(opened(archive_of((f"points3D.{form}", data))), "", form, model)
    assert found.of == {image: pytest.approx((4.0, 6.5)) for image in track}


def test_points_that_cannot_be_unpacked_are_told_and_passed_over() -> None:
    """Before points were read, such a zip was accepted."""
    path, model = "points3D.bin", ColmapModel()
    damaged = bytearray(archive_of((path, bytes(1000)), method=zipfile.ZIP_STORED))
    damaged[damaged.index(path.encode()) + len(path) + 500] = 1  # which its checksum contradicts
    found = depth_bounds(opened(bytes(damaged)), "", "bin", model)
    assert not found.of
    (warning,) = found.warnings
    assert warning["code"] == "points_not_read"
    assert "cannot be unpacked" in warning["message"]


@pytest.mark.parametrize("depth", [1e-40, 5e-324, 1e40, 1e308])
def test_depths_that_no_range_may_have_do_not_count(depth: float) -> None:
    track = struct.pack("<6I", 1, 0, 2, 0, 3, 0)
    points = 40 * (POINT.pack(1, 0, 0, depth, 0, 0, 0, 1.0, 3) + track)
    model = ColmapModel(images={1: ColmapImage("a", 1, IDENTITY)})
    files = opened(archive_of(("points3D.bin", struct.pack("<Q", 40) + points)))
    assert depth_bounds(files, "", "bin", model) == DepthBounds({})


@pytest.mark.parametrize(("count", "told"), [(MIN_POINTS - 1, False), (MIN_POINTS, True)])
def test_so_many_points_tell_the_depths_of_a_view(count: int, told: bool) -> None:
    """Of images in text, whose ids may be any whole numbers, those that no point can name have no bounds."""
    model = ColmapModel(images={number: ColmapImage("a", 1, IDENTITY) for number in (-1, 1, 2**32 + 1)})
    points = "".join(f"{place} 0 0 5 0 0 0 1 1 0 2 0 3 0\n" for place in range(count))
    found = depth_bounds(opened(archive_of(("points3D.txt", points.encode()))), "", "txt", model)
    assert found.of == ({1: pytest.approx((4.0, 6.5))} if told else {})


def test_views_whose_pose_is_refused_take_no_bounds_from_the_others() -> None:
    """One of a quaternion of zeros, and one of a frame whose rig is missing."""
    images = {1: ColmapImage("a", 1, IDENTITY), 2: ColmapImage("b", 1, (0.0,) * 7), 3: ColmapImage("c", 1, IDENTITY)}
    model = ColmapModel(images=images, frames={4: ColmapFrame(6, IDENTITY, (((0, 1), 3),))})
    points = MIN_POINTS * b"7 0 0 5 0 0 0 1 1 0 2 0 3 0\n"
    found = depth_bounds(opened(archive_of(("points3D.txt", points))), "", "txt", model)
    assert found == DepthBounds({1: pytest.approx((4.0, 6.5))})


def test_any_depths_that_count_make_a_range_that_is_accepted() -> None:
    assert depth_range(arc(2), BEFORE * SMALLEST, BEYOND * LARGEST).source == "given"


def test_points_of_one_model_are_in_memory_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    held: list[bool] = []
    lock = threading.Lock()
    monkeypatch.setattr(colmap_points, "_one_at_a_time", lock)

    class Watched(FolderFiles):
        def has(self, path: str) -> bool:
            return True

        def open(self, path: str) -> BinaryIO:
            held.append(lock.locked())
            return io.BytesIO(struct.pack("<Q", 0))

    assert depth_bounds(Watched(Path()), "", "bin", ColmapModel()) == DepthBounds({})
    assert (held, lock.locked()) == ([True], False)
