"""Reconstructions with `detail`: the grid of each result, the scene document, and refusals."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from plane_scene import PlaneScene

from gapmes.service import inputs, reconstruct
from gapmes.service.cameras.camera import Camera
from gapmes.service.errors import InputError
from gapmes.service.harmonics import C0
from gapmes.service.leaving_out.budget import KEEP_ALL, Budget
from gapmes.service.mending.backdrop import CELL, MARGIN, RINGS
from gapmes.service.mending.detail_level import checked_detail
from gapmes.service.network.engine import Engine
from gapmes.service.photographs import fitting
from gapmes.service.photographs.images import FittedView, Photo, fit_view
from gapmes.service.reconstruct import Reconstructor

PLANE = {"near": 2.0, "far": 8.0}


def test_a_reconstruction_with_detail(engine: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "gapmes.service.mending.backdrop.DEEPER", 0.0
    )  # where second ones stand hangs on depths, which differ
    sharp = PlaneScene.make(np.random.default_rng(7), size=(192, 144))
    service = Reconstructor(engine)
    given = {**PLANE, "budget": KEEP_ALL}
    plain, fine = (service.reconstruct(sharp.images, sharp.cameras, detail=detail, **given) for detail in (1, 2))
    info = engine.info
    assert [scene.document["detail"] for scene in (plain, fine)] == [1, 2]
    assert {camera.width for camera in fine.view_cameras} == {2 * info.width}
    assert {pixels.shape for pixels in fine.inputs} == {(2 * info.height, 2 * info.width, 3)}
    assert fine.document["warnings"] == plain.document["warnings"] == []
    rows = {row["what"]: row for row in fine.document["left_out"]}
    total = 3 * 4 * info.height * info.width
    assert (
        fine.document["gaussians"]["count"]
        + sum(row["count"] for what, row in rows.items() if what.startswith("Gaussians: faded"))
        == total + fine.document["gaussians"]["added"]
    )
    assert fine.document["gaussians"]["added"] == plain.document["gaussians"]["added"]
    cells = np.array([info.height, info.width]) // CELL + 2 * (len(MARGIN) + len(RINGS))  # of the network's grid
    assert fine.document["gaussians"]["added"] == 3 * cells.prod()
    assert fine.document["routing"] == plain.document["routing"]
    for name in ("textureless_share", "no_parallax_share", "depth_step"):
        assert fine.document["check"][name] == plain.document["check"][name]
    assert "detail" in fine.document["timings"]
    again = service.reconstruct(sharp.images, sharp.cameras, detail=2, **given)
    np.testing.assert_array_equal(again.gaussians.harmonics, fine.gaussians.harmonics)


def test_which_grid_each_step_works_on(engine: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    """Poses, depth range and what cannot be measured go by what the network saw; depths are refined on both grids."""
    widths: dict[str, list[int]] = {}

    def recorded(name: str, place: int) -> None:
        module = inputs if name in ("check_photos", "narrowed") else reconstruct
        own = getattr(module, name)

        def listening(*given: Any, **options: Any) -> Any:
            widths.setdefault(name, []).append(given[place][0].camera.width)
            return own(*given, **options)

        monkeypatch.setattr(module, name, listening)

    steps = {
        "check_photos": 0,
        "narrowed": 1,
        "at_mended_depths": 2,
        "at_finer_depths": 2,
        "mended": 1,
        "self_check": 0,
    }
    for name, place in steps.items():
        recorded(name, place)
    sharp = PlaneScene.make(np.random.default_rng(7), size=(192, 144))
    Reconstructor(engine).reconstruct(sharp.images, sharp.cameras, detail=2, leave_one_out=2)
    small, large, three = engine.info.width, 2 * engine.info.width, [engine.info.width] * 3
    assert widths == {
        "check_photos": [small],
        "narrowed": [small],
        "at_mended_depths": [small, *three],  # and of the two others of each, which foretell it
        "at_finer_depths": [large],
        "mended": [large, *three],
        "self_check": [small],
    }


@pytest.mark.parametrize("detail", [1, 2])
def test_the_other_size_that_mends_at_last(detail: int, engine: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    """The network's where the scene has twice as many pixels, else twice as many; of a view's others those others'."""
    sharp = PlaneScene.make(np.random.default_rng(7), size=(192, 144))
    heard: list[tuple[list[np.ndarray], list[np.ndarray]]] = []
    own = reconstruct.mended

    def listening(*given: Any, resized: Any, **options: Any) -> Any:
        heard.append(([view.image for view in given[1]], [view.image for view in resized]))
        return own(*given, resized=resized, **options)

    monkeypatch.setattr(reconstruct, "mended", listening)
    Reconstructor(engine).reconstruct(sharp.images, sharp.cameras, detail=detail, leave_one_out=2, **PLANE)
    height, width = engine.info.height, engine.info.width
    given = zip(sharp.images, sharp.cameras, strict=True)
    small, fine = zip(
        *([fit_view(Photo(image), camera, k * height, k * width).image for k in (1, 2)] for image, camera in given),
        strict=True,
    )
    first = (small, fine) if detail == 1 else (fine, small)
    others = [[1, 2], [0, 2], [0, 1]]
    expected = [first, *(([small[i] for i in two], [fine[i] for i in two]) for two in others)]
    for (views, resized), (these, those) in zip(heard, expected, strict=True):
        for found, wanted in zip([*views, *resized], [*these, *those], strict=True):
            np.testing.assert_array_equal(found, wanted)


def test_a_mask_holds_at_the_other_size_too(engine: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    sharp = PlaneScene.make(np.random.default_rng(7), size=(192, 144))
    alpha = np.where(np.hypot(*(np.mgrid[:144, :192] - [[[71.0]], [[95.0]]])) < 60, 255, 0).astype(np.uint8)
    images, heard = [np.dstack([image, alpha]) for image in sharp.images], []
    own = reconstruct.mended

    def listening(*given: Any, resized: Any, **options: Any) -> Any:
        heard.extend((view.mask, large.mask) for view, large in zip(given[1], resized, strict=True))
        return own(*given, resized=resized, **options)

    monkeypatch.setattr(reconstruct, "mended", listening)
    Reconstructor(engine).reconstruct(images, sharp.cameras, leave_one_out=0, trust_poses=True, **PLANE)
    assert len(heard) == 3
    for small, large in heard:
        assert large.shape == (2 * engine.info.height, 2 * engine.info.width)
        assert 0.3 < large.mean() < 0.9
        assert not (large & ~small.repeat(2, axis=0).repeat(2, axis=1)).any()


def test_nothing_looks_at_finer_photographs_without_mending(engine: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    sharp, sizes = PlaneScene.make(np.random.default_rng(7), size=(192, 144)), []
    own = fitting.fit_view

    def listening(photo: Photo, camera: Camera, height: int, width: int) -> FittedView:
        sizes.append((height, width))
        return own(photo, camera, height, width)

    monkeypatch.setattr(fitting, "fit_view", listening)
    Reconstructor(engine).reconstruct(sharp.images, sharp.cameras, fade=0, leave_one_out=0, **PLANE)
    assert sizes == 3 * [(engine.info.height, engine.info.width)]


def test_the_networks_own_with_detail_and_without_mending(engine: Engine) -> None:
    sharp = PlaneScene.make(np.random.default_rng(7), size=(192, 144))
    scene = Reconstructor(engine).reconstruct(
        sharp.images, sharp.cameras, detail=2, fade=0, budget=KEEP_ALL, leave_one_out=0, **PLANE
    )
    per_view = 4 * engine.info.height * engine.info.width
    pixels, z = scene.view_cameras[0].project(scene.gaussians.means[:per_view])
    np.testing.assert_allclose(z, math.sqrt(16.0), rtol=2e-6)
    assert np.abs(pixels - np.floor(pixels) - 0.5).max() < 1e-3


def test_a_photograph_without_the_pixels_is_told(engine: Engine, plane_scene: PlaneScene) -> None:
    """96 x 72 px, where the network sees 64 x 48."""
    scene = Reconstructor(engine).reconstruct(
        plane_scene.images, plane_scene.cameras, detail=2, fade=0, leave_one_out=0, **PLANE
    )
    found = [warning for warning in scene.document["warnings"] if warning["code"] == "detail_beyond_photograph"]
    assert [warning["index"] for warning in found] == [0, 1, 2]
    assert "96 px" in found[0]["message"]
    assert "128 px" in found[0]["message"]


@pytest.mark.parametrize(
    ("detail", "stride", "most", "said"),
    [
        (3, 1, 2, "is 3, need one of (1, 2)"),
        (0, 1, 2, "is 0, need one of (1, 2)"),
        (True, 1, 2, "is True, need one of (1, 2)"),
        (2, 1, 1, "is 2, the limit is 1"),
        (2, 2, 2, "is 2 beside stride 2"),
    ],
)
def test_other_details_are_refused(detail: int, stride: int, most: int, said: str) -> None:
    with pytest.raises(InputError) as caught:
        checked_detail(detail, stride, most)
    assert caught.value.field == "detail"
    assert caught.value.message.startswith(said)


def test_a_reconstruction_refuses_them_before_any_work(engine: Engine, plane_scene: PlaneScene) -> None:
    with pytest.raises(InputError, match="beside stride 4"):
        Reconstructor(engine).reconstruct(
            plane_scene.images, plane_scene.cameras, detail=2, budget=Budget(stride=4), **PLANE
        )


def test_a_ragged_mask_brings_no_colour_of_what_it_hides(engine: Engine) -> None:
    """A bright photograph with a disc kept: the network sees black beyond it, and pixels that are half kept."""
    rng = np.random.default_rng(4)
    images, cameras = [], PlaneScene.make(rng, size=(192, 144)).cameras
    y, x = np.mgrid[:144, :192] + 0.5
    disc = np.where(np.hypot(x - 97.3, y - 71.1) < 55.6, 255, 0).astype(np.uint8)
    for _ in cameras:
        images.append(np.dstack([rng.integers(180, 221, (144, 192, 3), dtype=np.uint8), disc]))
    scene = Reconstructor(engine).reconstruct(
        images, cameras, detail=2, fade=0, budget=KEEP_ALL, leave_one_out=0, trust_poses=True, **PLANE
    )
    own = scene.gaussians.harmonics[:, 0] * C0 + 0.5
    per_view = own[: sum(int((pixels[..., 3] > 0).sum()) for pixels in scene.inputs)]
    assert per_view.min() > 0.65  # 180 / 255 = 0.706, and what Hamming's filter rings
