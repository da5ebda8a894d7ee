"""Fitting photographs to the network: one at a time at full size, each with some pixel left under its mask."""

import io
import weakref
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.camera_fields import view_through
from gapmes.service.cameras.distortion import Lens
from gapmes.service.cameras.pose import checked_pose
from gapmes.service.errors import ImageError
from gapmes.service.photographs import fitting as fitting_module
from gapmes.service.photographs import images as images_module
from gapmes.service.photographs.fitting import fit_notices, fitted, fitted_photos
from gapmes.service.photographs.images import EncodedPhoto, Photo
from gapmes.service.reconstruct import Reconstructor


@pytest.fixture(scope="module")
def reconstructor(engine):
    return Reconstructor(engine)


def test_a_mask_outside_of_what_a_scene_has_of_a_panorama_is_refused(reconstructor):
    """400 x 72 px of which the middle 192 columns are used, and a mask that keeps 40 columns at the left."""
    rng = np.random.default_rng(3)
    cameras, images = [], []
    for index in range(2):
        pose = np.eye(4)
        pose[0, 3] = 0.2 * index
        cameras.append(Camera.make(400, 72, 100.0, 100.0, 200.0, 36.0, pose))
        alpha = np.full((72, 400, 1), 255, np.uint8)
        alpha[:, 40 * index :] *= index == 0
        images.append(np.concatenate([rng.integers(0, 256, (72, 400, 3), dtype=np.uint8), alpha], axis=2))
    with pytest.raises(ImageError, match=r"the mask keeps 0 of 128 x 48 px, the middle 48% of") as caught:
        reconstructor.reconstruct(images, cameras, near=1, far=10)
    assert (caught.value.status, caught.value.index) == (422, 1)
    assert "crop the photograph" in caught.value.cure


def test_a_mask_that_only_the_coarse_grid_sees_holds_on_the_fine_one_too(engine):
    """Every third row and column are left out: most of each fine pixel is kept, and of some coarse ones too little."""
    info, (height, width) = engine.info, (3 * engine.info.height, 3 * engine.info.width)
    y, x = np.mgrid[:height, :width]
    out = ((y % 3 == 1) | (x % 3 == 1)) & (x < width // 2)
    pixels = np.dstack([np.full((height, width, 3), 90, np.uint8), np.where(out, 0, 255).astype(np.uint8)])
    camera = Camera.make(width, height, width, width, width / 2, height / 2, np.eye(4))
    small, fine, _ = fitted(pixels, camera, 0, info.shape, detail=2, finer=2)
    assert small.mask is not None
    assert not small.mask.all()
    assert fine.mask is not None
    assert not (fine.mask & ~small.mask.repeat(2, axis=0).repeat(2, axis=1)).any()


def test_encoded_photographs_are_decoded_one_at_a_time(reconstructor, plane_scene, monkeypatch):
    """When the next one is decoded, nobody holds the one before; the scene is the same."""
    alive, original = [], images_module.decode_image

    def watched(data, **options):
        assert [ref for ref in alive if ref() is not None] == []
        photo = original(data, **options)
        alive.append(weakref.ref(photo))
        return photo

    monkeypatch.setattr(images_module, "decode_image", watched)
    encoded = []
    for image in plane_scene.images:
        buffer = io.BytesIO()
        Image.fromarray(image).save(buffer, "PNG")
        encoded.append(EncodedPhoto(buffer.getvalue()))
    scene = reconstructor.reconstruct(plane_scene.images, plane_scene.cameras, near=2, far=8)
    result = reconstructor.reconstruct(encoded, plane_scene.cameras, near=2, far=8)
    assert len(alive) == len(encoded)
    np.testing.assert_array_equal(result.gaussians.means, scene.gaussians.means)
    np.testing.assert_array_equal(result.gaussians.harmonics, scene.gaussians.harmonics)


@pytest.mark.parametrize(("detail", "kept"), [(1, 0), (2, 3)])
def test_fine_pictures_that_the_scene_does_not_show_are_kept_packed_alone(
    engine, plane_scene, monkeypatch, detail, kept
):
    made, original = [], fitting_module.fit_view

    def watched(*given):
        view = original(*given)
        made.append(weakref.ref(view.image))
        return view

    monkeypatch.setattr(fitting_module, "fit_view", watched)
    numbers, done = range(len(plane_scene.images)), []
    options = {"finer": 2, "done": done.append}
    found = fitted_photos(
        plane_scene.images, plane_scene.cameras, numbers, [engine.info.shape] * len(numbers), detail, **options
    )
    sizes = [ref().shape[-1] for ref in made if ref() is not None]
    assert sizes.count(2 * engine.info.width) == kept
    assert sizes.count(engine.info.width) == len(numbers) == len(found.seen)
    assert [view.camera.width for view in found.shown] == [detail * engine.info.width] * len(numbers)
    assert [view.camera.width for view in found.fine] == [2 * engine.info.width] * len(numbers)
    assert done == [1, 2, 3]


@pytest.mark.parametrize("bent", [False, True])
@pytest.mark.parametrize(("orientation", "told"), [(1, False), (3, True), (6, True)])
def test_what_exif_says_is_told_whether_the_lens_bends_or_not(engine, bent, orientation, told):
    photo = Photo(np.zeros((480, 640, 3), np.uint8), orientation=orientation)
    lens = Lens(640, 480, 500.0, 500.0, 320.0, 240.0, k1=0.05)
    camera = Camera.make(640, 480, 500.0, 500.0, 320.0, 240.0, np.eye(4))
    notices = fit_notices(photo, camera, lens if bent else None, 1, engine.info.shape)
    assert [notice["code"] for notice in notices] == ["exif_orientation_ignored"] * told + ["undistorted"] * bent
    assert {notice["index"] for notice in notices} <= {1}
    if told:
        assert "the stored size 640 x 480" in notices[0]["message"]
        assert ("lie on their side" in notices[0]["message"]) == (orientation == 6)


@pytest.mark.parametrize("bent", [False, True])
@pytest.mark.parametrize(
    ("stored", "seen", "told"), [((1000, 1005), (1005, 1000), False), ((47, 32), (1500, 1000), True)]
)
def test_what_exif_says_is_told_where_it_was_not_done(engine, bent, stored, seen, told):
    """Nearly square, and turned; and so small that whole pixels change the aspect by 2 %, and left as it is stored."""
    photo = Photo(np.random.default_rng(2).integers(0, 256, (*stored[::-1], 3), dtype=np.uint8), orientation=6)
    lens = Lens(*seen, 1000.0, 1000.0, seen[0] / 2, seen[1] / 2, k1=0.05)
    camera = view_through(None, lens if bent else replace(lens, k1=0.0), checked_pose(np.eye(4)), field="x").camera
    buffer = io.BytesIO()
    Image.fromarray(photo.rgb).save(buffer, "PNG", exif=_turned(6))
    encoded = EncodedPhoto(buffer.getvalue(), lens=lens if bent else None)
    for notices in (
        fit_notices(photo, camera, encoded.lens, 1, engine.info.shape),
        fitted(encoded, camera, 1, engine.info.shape)[2],
    ):
        assert [notice["code"] for notice in notices] == ["exif_orientation_ignored"] * told + ["undistorted"] * bent


def _turned(orientation: int) -> Image.Exif:
    exif = Image.Exif()
    exif[0x112] = orientation
    return exif


def test_a_bent_photograph_of_another_resolution_has_a_pinhole_of_whole_pixels(engine):
    """1000 x 666 px of a lens of 6000 x 4000: its pinhole of 7234 x 4302 px has 1205.7 x 716.3 there, 1206 x 716 in
    whole pixels, whose aspect is another by more than 1 px. A square of the scene stands where its camera has it."""
    lens = Lens(6000, 4000, 3900.0, 3900.0, 3000.0, 2000.0, k1=-0.25, k2=0.06)
    camera = view_through(None, lens, checked_pose(np.eye(4)), field="x").camera
    across = (np.arange(1000) + 0.5) * (6000 / 1000)
    down = (np.arange(666) + 0.5) * (4000 / 666)
    x, y = lens.undistorted(*np.meshgrid((across - lens.cx) / lens.fx, (down - lens.cy) / lens.fy))
    square = (np.abs(x - 0.1) < 0.1) & (np.abs(y + 0.2) < 0.1)
    pixels = np.repeat(np.where(square, 255, 0).astype(np.uint8)[:, :, None], 3, axis=2)
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG")
    photo = EncodedPhoto(buffer.getvalue(), lens=lens)
    view, _, notices = fitted(photo, camera, 0, engine.info.shape)
    assert [notice["code"] for notice in notices] == ["undistorted"]
    height, width = view.image.shape[1:]
    weights = view.image[0] / view.image[0].sum()
    middle = weights.sum(axis=0) @ (np.arange(width) + 0.5), weights.sum(axis=1) @ (np.arange(height) + 0.5)
    expected = view.camera.fx * 0.1 + view.camera.cx, view.camera.fy * -0.2 + view.camera.cy
    np.testing.assert_allclose(middle, expected, atol=0.05)
    wrong = camera.cropped(0, 0, 6000, 4000)
    with pytest.raises(ImageError, match="its camera 6000 x 4000 px: the aspects differ"):
        fitted(photo, wrong, 0, engine.info.shape)
    with pytest.raises(ImageError, match="its camera 6000 x 4000 px: the aspects differ"):
        fit_notices(Photo(pixels), wrong, lens, 0, engine.info.shape)


def test_a_bent_photograph_that_is_smaller_than_the_scene_is_told_of_before_it_is_resampled(engine):
    """Of a lens of 2000 x 1500 px a photograph of 100 x 75."""
    lens = Lens(2000, 1500, 1800.0, 1800.0, 1000.0, 750.0, k1=-0.1)
    camera = view_through(None, lens, checked_pose(np.eye(4)), field="x").camera
    photo = Photo(np.random.default_rng(1).integers(0, 256, (75, 100, 3), dtype=np.uint8))
    buffer = io.BytesIO()
    Image.fromarray(photo.rgb).save(buffer, "PNG")
    told = fit_notices(photo, camera, lens, 1, engine.info.shape, 2)
    assert [notice["code"] for notice in told] == ["undistorted", "detail_beyond_photograph"]
    assert told == fitted(EncodedPhoto(buffer.getvalue(), lens=lens), camera, 1, engine.info.shape, 2, finer=2)[2]
