"""Photographs on their way to the network: one at a time at full size, and each with something left under its mask."""

import io
import weakref

import numpy as np
import pytest
from PIL import Image

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.distortion import Lens
from gapmes.service.errors import ImageError
from gapmes.service.photographs import fitting as fitting_module
from gapmes.service.photographs import images as images_module
from gapmes.service.photographs.fitting import fit_notices, fitted, fitted_photos
from gapmes.service.photographs.images import EncodedPhoto, Photo
from gapmes.service.reconstruct import Reconstructor


@pytest.fixture(scope="module")
def reconstructor(engine):
    return Reconstructor(engine)


def test_a_mask_outside_the_centre_crop_is_refused(reconstructor):
    """200 x 72 px of which the middle 96 columns are seen, and a mask that keeps 40 columns at the left."""
    rng = np.random.default_rng(3)
    cameras, images = [], []
    for index in range(2):
        pose = np.eye(4)
        pose[0, 3] = 0.2 * index
        cameras.append(Camera.make(200, 72, 100.0, 100.0, 100.0, 36.0, pose))
        alpha = np.full((72, 200, 1), 255, np.uint8)
        alpha[:, 40 * index :] *= index == 0
        images.append(np.concatenate([rng.integers(0, 256, (72, 200, 3), dtype=np.uint8), alpha], axis=2))
    with pytest.raises(ImageError, match=r"the mask keeps 0 of 64 x 48 px of the centre crop, 48% of") as caught:
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
    small, fine, _ = fitted(pixels, camera, 0, info, detail=2, finer=2)
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
    found = fitted_photos(plane_scene.images, plane_scene.cameras, numbers, engine.info, detail, **options)
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
    notices = fit_notices(photo, camera, lens if bent else None, 1, engine.info)
    assert [notice["code"] for notice in notices] == ["exif_orientation_ignored"] * told + ["undistorted"] * bent
    assert {notice["index"] for notice in notices} <= {1}
    if told:
        assert "the stored size 640 x 480" in notices[0]["message"]
