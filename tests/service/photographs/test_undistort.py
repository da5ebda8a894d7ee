"""Undistortion: photographs through a lens become those of a pinhole camera, and nothing is read beyond them."""

from __future__ import annotations

import io
import math
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.camera_fields import view_through
from gapmes.service.cameras.distortion import Lens, pinhole_window
from gapmes.service.cameras.pose import checked_pose
from gapmes.service.errors import ImageError, IntrinsicsError
from gapmes.service.photographs.fitting import fitted
from gapmes.service.photographs.images import EncodedPhoto, Photo
from gapmes.service.photographs.undistort import MAX_SIDE, undistorted

LENSES = {
    "barrel": Lens(320, 240, 250.0, 255.0, 163.0, 117.0, k1=-0.2, k2=0.04, p1=0.001, p2=-0.002),
    "pincushion": Lens(320, 240, 250.0, 255.0, 163.0, 117.0, k1=0.15, p2=0.002),
    "rational": Lens(320, 240, 250.0, 250.0, 160.0, 120.0, k1=0.1, k2=-0.05, k3=0.01, k4=0.3, k5=0.05, k6=0.01),
    "eighth power": Lens(320, 240, 250.0, 250.0, 160.0, 120.0, k1=-0.1, r8=0.05),
}


def scene(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Smooth colours of the rays with slopes x, y: waves of 30 px and more, so that bilinear sampling is close."""
    phases = np.array([0.0, 1.0, 2.0])
    return 127.5 + 90 * np.sin(40 * x[..., None] + phases) * np.cos(35 * y[..., None] - phases)


def pixel_slopes(width: int, height: int, fx: float, fy: float, cx: float, cy: float) -> tuple[np.ndarray, np.ndarray]:
    return np.meshgrid((np.arange(width) + 0.5 - cx) / fx, (np.arange(height) + 0.5 - cy) / fy)


def through(lens: Lens) -> Photo:
    """What the lens photographs of the scene: the colour of the ray that ends in each pixel."""
    slopes = pixel_slopes(lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy)
    colours = scene(*lens.undistorted(*slopes))
    return Photo(np.rint(colours).astype(np.uint8))


def pinhole_camera(lens: Lens) -> Camera:
    return view_through(None, lens, checked_pose(np.eye(4)), field="x").camera


@pytest.mark.parametrize("name", LENSES)
def test_the_picture_is_the_pinholes(name: str) -> None:
    """Worst difference 2.5 levels, mean 0.35: bilinear sampling between waves, and rounding twice. A shift by a tenth
    of a pixel has a mean of 0.66, by half a pixel one of 2.9."""
    lens = LENSES[name]
    camera, photo = pinhole_camera(lens), undistorted(through(lens), lens)
    assert (photo.width, photo.height) == (camera.width, camera.height)
    assert photo.mask is None
    slopes = pixel_slopes(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
    difference = np.abs(photo.rgb - scene(*slopes))
    assert difference.max() < 3.5
    assert difference.mean() < 0.45


@pytest.mark.parametrize("name", LENSES)
def test_no_pixel_comes_from_beyond_the_photograph_and_none_could_be_added(name: str) -> None:
    lens = LENSES[name]
    window = pinhole_window(lens)

    def inside(left: float, top: float, right: float, bottom: float) -> bool:
        x, y = np.meshgrid(np.linspace(left, right, 200), np.linspace(top, bottom, 200))
        x, y = lens.distorted((x - lens.cx) / lens.fx, (y - lens.cy) / lens.fy)
        x, y = x * lens.fx + lens.cx, y * lens.fy + lens.cy
        reach = 0.02  # px; the sides are looked at in 64 pieces, and bulge between them by less
        return bool(((x >= -reach) & (x <= lens.width + reach) & (y >= -reach) & (y <= lens.height + reach)).all())

    box = (window.left, window.top, window.left + window.width, window.top + window.height)
    assert inside(*box)
    for place, step in enumerate((-2, -2, 2, 2)):
        assert not inside(*(value + step * (place == side) for side, value in enumerate(box)))


@pytest.mark.parametrize("name", LENSES)
def test_the_kept_share_is_the_area_of_what_is_read(name: str) -> None:
    """Against the share of the photograph's pixels whose rays end in the window, counted one by one."""
    lens, window = LENSES[name], pinhole_window(LENSES[name])
    x, y = lens.undistorted(*pixel_slopes(lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy))
    x, y = x * lens.fx + lens.cx - window.left, y * lens.fy + lens.cy - window.top
    counted = ((x >= 0) & (x <= window.width) & (y >= 0) & (y <= window.height)).mean()
    assert window.kept_share == pytest.approx(counted, abs=0.005)
    assert 0.85 < window.kept_share <= 1


def test_a_lens_without_distortion_changes_nothing() -> None:
    lens = Lens(320, 240, 250.0, 255.0, 163.0, 117.0)
    window = pinhole_window(lens)
    assert (window.left, window.top, window.width, window.height) == (0, 0, 320, 240)
    assert window.kept_share == pytest.approx(1.0)
    photo = through(lens)
    np.testing.assert_array_equal(undistorted(photo, lens).rgb, photo.rgb)


def test_photographs_at_another_resolution_and_turned() -> None:
    """Half the size, and lying on its side with EXIF saying so: the same picture."""
    lens = LENSES["barrel"]
    whole = undistorted(through(lens), lens)
    half = through(replace(lens, width=160, height=120, fx=125.0, fy=127.5, cx=81.5, cy=58.5))
    small = undistorted(half, lens)
    assert abs(small.width - whole.width / 2) <= 0.5
    assert abs(small.height - whole.height / 2) <= 0.5
    even = whole.rgb[: 2 * (whole.height // 2), : 2 * (whole.width // 2)].astype(float)
    mean = even.reshape(whole.height // 2, 2, whole.width // 2, 2, 3).mean(axis=(1, 3))
    assert np.abs(mean - small.rgb[: mean.shape[0], : mean.shape[1]]).mean() < 3  # 2.5; a pixel off it is 12
    lying = Photo(np.ascontiguousarray(np.rot90(through(lens).rgb)), orientation=6)
    np.testing.assert_array_equal(undistorted(lying, lens).rgb, whole.rgb)
    with pytest.raises(ImageError, match="the aspects differ"):
        undistorted(Photo(np.zeros((100, 100, 3), np.uint8)), lens, index=3)


def test_the_warning_speaks_of_the_photographs_pixels() -> None:
    """A photograph of a quarter of the size that its camera is given for."""
    lens = LENSES["barrel"]
    camera = pinhole_camera(lens)
    large = through(lens)
    small = Photo(np.ascontiguousarray(large.rgb[::4, ::4]))
    for photo, scale in ((large, 1.0), (small, 0.25)):
        made = undistorted(photo, lens)
        (notice,) = fitted(photo_of(photo, lens), camera, 5, (64, 64))[2]
        assert f"by up to {scale * lens.largest_shift():.3g} px: " in notice["message"]
        assert f"a pinhole of {made.width} x {made.height} px, which shows " in notice["message"]
        assert notice["index"] == 5


def photo_of(photo: Photo, lens: Lens) -> EncodedPhoto:
    buffer = io.BytesIO()
    Image.fromarray(photo.rgb).save(buffer, "PNG")
    return EncodedPhoto(buffer.getvalue(), lens=lens)


def test_masks_are_bent_with_the_colours_and_let_none_through() -> None:
    lens = LENSES["barrel"]
    photo = through(lens)
    x, _ = lens.undistorted(*pixel_slopes(lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy))
    kept = x < 0.1
    harmed = np.where(kept[:, :, None], photo.rgb, 255)
    result = undistorted(Photo(harmed.astype(np.uint8), kept), lens)
    camera = pinhole_camera(lens)
    across, down = pixel_slopes(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
    assert (result.mask == (across < 0.1))[np.abs(across - 0.1) > 1.0 / lens.fx].all()
    inside = np.abs(result.rgb - scene(across, down))[result.mask]
    assert inside.max() < 10  # 6.4: next to the mask a colour is that of the kept neighbours
    assert inside.mean() < 0.45  # 0.33
    assert (result.rgb[~result.mask] == 0).all()


@pytest.mark.parametrize(("megapixels", "masked", "most"), [(24, False, 50e6), (3, True, 65e6)])
def test_memory_is_a_scaled_photograph_and_strips(megapixels: int, masked: bool, most: float) -> None:
    """Of 24 megapixels no more than a strip of coordinates is held at a time beside the scaled photograph: 32 MB. A
    mask adds a copy of the photograph with 0 for masked pixels, in 8 bits: 50 MB for 3 megapixels, 88 MB in float32."""
    across, down = {24: (6000, 4000), 3: (2000, 1500)}[megapixels]
    lens = Lens(across, down, across / 1.2, across / 1.2, across / 2, down / 2, k1=-0.1)
    mask = None
    if masked:
        mask = np.ones((down, across), np.bool_)
        mask[: down // 2, : across // 2] = False
    photo = Photo(np.zeros((down, across, 3), np.uint8), mask)
    tracemalloc.start()
    result = undistorted(photo, lens)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert max(result.width, result.height) <= MAX_SIDE
    window = pinhole_window(lens)
    assert result.width / result.height == pytest.approx(window.width / window.height, rel=1e-3)
    assert peak < most


@pytest.mark.parametrize(
    ("lens", "words"),
    [
        (Lens(320, 240, 250.0, 250.0, 160.0, 120.0, k1=-2.0), "folds the picture over"),
        (Lens(320, 240, 250.0, 250.0, 160.0, 120.0, k1=math.nan), "folds the picture over"),
        (Lens(320, 240, 250.0, 250.0, 160.0, 120.0, k1=1e308), "folds the picture over|holds 0%"),
        (Lens(320, 240, 250.0, 250.0, 160.0, 120.0, k4=5.0), "folds the picture over"),
        (Lens(320, 240, 100.0, 100.0, 160.0, 120.0, k1=-0.35, k2=0.06), "holds 45% of the photograph's pixels"),
    ],
)
def test_lenses_that_no_pinhole_shows(lens: Lens, words: str) -> None:
    with pytest.raises(IntrinsicsError, match=words) as caught:
        view_through("a.png", lens, checked_pose(np.eye(4)), field="cameras", index=4)
    assert (caught.value.field, caught.value.index) == ("cameras.distortion", 4)
    assert "image_undistorter" in caught.value.cure


@pytest.mark.parametrize(("width", "height"), [(160, 120), (161, 120), (160, 121)])
def test_a_photograph_of_another_size_than_its_lens_is_the_pinholes_too(width: int, height: int) -> None:
    """Also where a side is rounded. Mean difference 0.75 levels; with one axis scaled as the other 2.7 and more."""
    lens = LENSES["barrel"]
    x, y = width / lens.width, height / lens.height
    resized = replace(lens, width=width, height=height, fx=lens.fx * x, fy=lens.fy * y, cx=lens.cx * x, cy=lens.cy * y)
    photo = undistorted(through(resized), lens)
    camera = pinhole_camera(lens).resized(photo.width, photo.height)
    slopes = pixel_slopes(photo.width, photo.height, camera.fx, camera.fy, camera.cx, camera.cy)
    assert np.abs(photo.rgb - scene(*slopes)).mean() < 1.0


def test_what_exif_says_and_was_not_done_is_kept() -> None:
    """Whether the cameras are those of the turned photographs is asked of what the network sees."""
    lens = LENSES["barrel"]
    assert undistorted(replace(through(lens), orientation=3), lens).orientation == 3
