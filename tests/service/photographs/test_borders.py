"""Bars at the borders of photographs are left out, to the pixel, and backdrops stay."""

import io
import json

import numpy as np
import pytest
from PIL import Image, ImageDraw
from sample_photographs import FAR, NEAR, sample_cameras, sample_pixels

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.distortion import Lens, pinhole_window
from gapmes.service.photographs.borders import SEAM, without_bars
from gapmes.service.photographs.fitting import fit_notices, fitted
from gapmes.service.photographs.images import EncodedPhoto, Photo
from gapmes.service.photographs.masks import MASKED
from gapmes.service.reconstruct import Reconstructor
from gapmes.service.shipped import sample_folder

HEIGHT, WIDTH = 240, 320
BLACK, WHITE, RED = (0, 0, 0), (255, 255, 255), (180, 40, 60)
PAIRS = {"rows": ("top", "bottom"), "columns": ("left", "right"), "frame": ("top", "bottom", "left", "right")}


def content(height: int = HEIGHT, width: int = WIDTH, seed: int = 0) -> np.ndarray:
    """Patches of 8 px of any colour, blurred into each other."""
    coarse = np.random.default_rng(seed).integers(0, 256, (height // 8, width // 8, 3), dtype=np.uint8)
    return np.array(Image.fromarray(coarse).resize((width, height), Image.Resampling.BICUBIC))


def barred(pixels: np.ndarray, kind: str, thickness: int, colour: tuple[int, ...]) -> np.ndarray:
    pixels = pixels.copy()
    height, width = pixels.shape[:2]
    if kind != "columns":
        pixels[:thickness] = pixels[height - thickness :] = colour
    if kind != "rows":
        pixels[:, :thickness] = pixels[:, width - thickness :] = colour
    return pixels


def encoded(pixels: np.ndarray, quality: int | None) -> np.ndarray:
    if quality is None:
        return pixels
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "JPEG", quality=quality)
    return np.asarray(Image.open(buffer))


def found_in(pixels: np.ndarray) -> dict[str, int]:
    return {
        side: width - SEAM
        for bars in without_bars(Photo.from_array(pixels))[1]
        for side, width in zip(bars.sides, bars.widths, strict=True)
    }


@pytest.mark.parametrize("columns", [slice(0, 1), slice(-2, None), [0, -1]])
def test_a_letterbox_with_black_columns_is_one(columns: slice | list[int]) -> None:
    """Films have them at the sides, too thin for a bar; they are left to be content."""
    pixels = barred(content(), "rows", 30, BLACK)
    pixels[:, columns] = 0
    assert found_in(pixels) == {"top": 30, "bottom": 30}


@pytest.mark.parametrize("kind", list(PAIRS))
@pytest.mark.parametrize("colour", [BLACK, (16, 16, 16), (128, 128, 128), WHITE, RED])
@pytest.mark.parametrize("thickness", [5, 29, 48])
def test_bars_are_found_to_the_pixel(kind: str, colour: tuple[int, ...], thickness: int) -> None:
    pixels = barred(content(), kind, thickness, colour)
    assert found_in(pixels) == dict.fromkeys(PAIRS[kind], thickness)
    photo, (first, *_) = without_bars(Photo.from_array(pixels))
    assert photo.mask is not None
    assert first.colour == colour
    inside = photo.mask[thickness + 1 : -thickness - 1, thickness + 1 : -thickness - 1]
    assert inside.all()
    rows, columns = photo.mask.any(axis=1).sum(), photo.mask.any(axis=0).sum()
    assert rows == HEIGHT - 2 * (thickness + SEAM) * (kind != "columns")
    assert columns == WIDTH - 2 * (thickness + SEAM) * (kind != "rows")
    np.testing.assert_array_equal(photo.rgb, pixels)


@pytest.mark.parametrize("kind", list(PAIRS))
@pytest.mark.parametrize("quality", [90, 75])
@pytest.mark.parametrize("colour", [BLACK, (128, 128, 128), WHITE, RED])
@pytest.mark.parametrize("index", [1, 3])
def test_bars_of_coded_photographs_are_found(kind: str, quality: int, colour: tuple[int, ...], index: int) -> None:
    """In the middle of a block, where its ripples are largest."""
    found = found_in(encoded(barred(sample_pixels(index), kind, 29, colour), quality))
    assert set(found) == set(PAIRS[kind])
    assert all(abs(thickness - 29) <= 1 for thickness in found.values()), found


def test_bars_of_a_resized_photograph_are_found() -> None:
    large = Image.fromarray(barred(content(), "rows", 29, BLACK))
    found = found_in(np.asarray(large.resize((WIDTH // 2, HEIGHT // 2), Image.Resampling.LANCZOS)))
    assert set(found) == {"top", "bottom"}
    assert set(found.values()) <= {14, 15}


def test_a_letterbox_within_bars_of_another_colour_is_found_too() -> None:
    pixels = barred(barred(content(), "rows", 20, WHITE), "columns", 30, BLACK)
    assert found_in(pixels) == {"top": 20, "bottom": 20, "left": 30, "right": 30}


def test_bars_may_differ_a_little_and_not_much() -> None:
    pixels = content()
    pixels[:30], pixels[-38:] = 0, 0
    assert found_in(pixels) == {"top": 30, "bottom": 38}
    pixels[-42:] = 0
    assert found_in(pixels) == {}


def test_a_picture_that_is_dark_at_one_edge_has_bars_of_one_thickness() -> None:
    """A third of the lower edge is seen, and all of the upper one."""
    pixels = content() // 2 + 100
    pixels[HEIGHT // 2 :, : 2 * WIDTH // 3] = 4
    assert found_in(barred(pixels, "rows", 30, BLACK)) == {"top": 30, "bottom": 30}
    pixels[-34:] = pixels[:30] = 0
    assert found_in(pixels) == {}


def before(colour: tuple[int, ...], draw: str, *box: float) -> np.ndarray:
    """A thing of this outline before a backdrop."""
    shape = Image.new("L", (WIDTH, HEIGHT))
    getattr(ImageDraw.Draw(shape), draw)(*box, fill=255)
    return np.where(np.asarray(shape)[:, :, None] > 0, content(seed=1), np.uint8(colour)).astype(np.uint8)


def sky(seed: int) -> np.ndarray:
    """Stars and noise over hills."""
    rng = np.random.default_rng(seed)
    pixels = 6 + rng.normal(0, 2, (HEIGHT, WIDTH, 3))
    pixels[rng.integers(0, HEIGHT, 60), rng.integers(0, WIDTH, 60)] = 200
    hills = 150 + 12 * np.sin(np.arange(WIDTH) / 40)
    pixels = np.where(np.arange(HEIGHT)[:, None, None] > hills[None, :, None], content() * 0.3 + 10, pixels)
    pixels[-60:] = 5
    return np.rint(pixels.clip(0, 255)).astype(np.uint8)


def one_bar(colour: tuple[int, ...]) -> np.ndarray:
    pixels = content()
    pixels[:30] = colour
    return pixels


def ramp(step: int) -> np.ndarray:
    """From the same level at both borders."""
    levels = (step * np.minimum(np.arange(HEIGHT), np.arange(HEIGHT)[::-1])).clip(0, 255).astype(np.uint8)
    return np.tile(levels[:, None, None], (1, WIDTH, 3))


def bluer(pixels: np.ndarray, *where: slice) -> np.ndarray:
    """With another level of blue there, and the same of red and green."""
    pixels = pixels.copy()
    pixels[where][..., 2] = 90
    return pixels


BACKDROPS = {
    "ball": lambda colour: before(colour, "ellipse", (60, 30, 260, 210)),
    "box": lambda colour: before(colour, "rectangle", (60, 50, 259, 169)),
    "box at the same height": lambda colour: before(colour, "rectangle", (40, 40, 259, 199)),
    "box with round corners": lambda colour: before(colour, "rounded_rectangle", (40, 40, 279, 199), 30),
    "turned box": lambda colour: before(colour, "polygon", [(50, 36), (276, 44), (270, 204), (44, 196)]),
    "one bar": one_bar,
    "bar of another colour": lambda colour: np.vstack([one_bar(colour)[:-30], np.full((30, WIDTH, 3), 90, np.uint8)]),
    "bar that differs in blue": lambda colour: bluer(barred(content(), "rows", 30, colour), slice(-30, None)),
    "frame that differs in blue": lambda colour: bluer(
        barred(content(), "frame", 30, colour), slice(None), slice(None, 30)
    ),
    "thin": lambda colour: barred(content(), "rows", 2, colour),
    "thick": lambda colour: barred(content(), "rows", 100, colour),
    "uniform": lambda colour: np.full((HEIGHT, WIDTH, 3), colour, np.uint8),
    "gradient": lambda _: ramp(2),
    "steep gradient": lambda _: ramp(3),
    "night": lambda colour: sky(sum(colour)),
    "none": lambda _: content(),
}


@pytest.mark.parametrize("name", list(BACKDROPS))
@pytest.mark.parametrize("colour", [BLACK, WHITE, (20, 60, 160)])
@pytest.mark.parametrize("quality", [None, 90, 75])
def test_backdrops_stay(name: str, colour: tuple[int, ...], quality: int | None) -> None:
    photo = Photo.from_array(encoded(BACKDROPS[name](colour), quality))
    same, found = without_bars(photo)
    assert found == []
    assert same is photo


def test_photographs_of_the_sample_have_none() -> None:
    count = len(json.loads((sample_folder() / "cameras.json").read_text())["views"])
    assert [found_in(sample_pixels(index)) for index in range(count)] == [{}] * count


@pytest.mark.parametrize("corner", [0, 255])
def test_a_mask_of_its_own_counts_alone(corner: int) -> None:
    """Also one that keeps everything."""
    alpha = np.full((HEIGHT, WIDTH), 255, np.uint8)
    alpha[0, 0] = corner
    photo = Photo.from_array(np.dstack([barred(content(), "rows", 30, BLACK), alpha]))
    assert without_bars(photo) == (photo, [])
    assert (photo.mask is None) == (corner == 255)


def camera(width: int = WIDTH, height: int = HEIGHT) -> Camera:
    return Camera.make(width, height, 300.0, 300.0, width / 2, height / 2, np.eye(4))


def test_the_warning_names_sides_share_and_cure(engine) -> None:
    photo = Photo.from_array(barred(content(), "rows", 23, RED))
    (notice,) = fit_notices(photo, camera(), None, 4, engine.info.shape)
    assert (notice["code"], notice["field"], notice["index"]) == ("border_left_out", "images", 4)
    assert "24 px at the top and 24 px at the bottom of the colour (180, 40, 60): 20% of it" in notice["message"]
    assert "from cy, or send an alpha channel" in notice["message"]
    assert fitted(photo, camera(), 4, engine.info.shape)[2] == [notice]


def test_sides_are_those_of_the_photograph_as_its_camera_has_it(engine) -> None:
    lying = Photo(np.ascontiguousarray(np.rot90(barred(content(), "rows", 23, BLACK))), orientation=6)
    for lens in (None, Lens(WIDTH, HEIGHT, 300.0, 300.0, WIDTH / 2, HEIGHT / 2, k1=0.05)):
        told = [notice["message"] for notice in fit_notices(lying, camera(), lens, 0, engine.info.shape)]
        assert any("24 px at the top and 24 px at the bottom" in message for message in told)


def test_bars_outside_the_crop_are_nothing_to_tell(engine) -> None:
    """The network's 4 : 3 of 720 x 240 px are the middle 320 columns."""
    photo = Photo.from_array(barred(content(HEIGHT, 720), "columns", 150, BLACK))
    assert len(without_bars(photo)[1]) == 1
    assert fit_notices(photo, camera(720), None, 0, engine.info.shape) == []


def test_bars_of_a_lens_are_found_before_it_is_undone(engine) -> None:
    """A bar's edge is a curve on the pinhole: nothing of its black is left among what is kept."""
    lens = Lens(WIDTH, HEIGHT, 300.0, 300.0, WIDTH / 2, HEIGHT / 2, k1=-0.15)
    window = pinhole_window(lens)
    pinhole = Camera.make(
        window.width, window.height, 300.0, 300.0, lens.cx - window.left, lens.cy - window.top, np.eye(4)
    )
    grey = np.full((HEIGHT, WIDTH, 3), 90, np.uint8) + content() // 3
    photo = Photo.from_array(barred(grey, "rows", 40, BLACK))
    notices = fit_notices(photo, pinhole, lens, 0, engine.info.shape)
    assert [notice["code"] for notice in notices] == ["undistorted", "border_left_out"]
    buffer = io.BytesIO()
    Image.fromarray(photo.rgb).save(buffer, "PNG")
    view, fine, told = fitted(EncodedPhoto(buffer.getvalue(), lens=lens), pinhole, 0, engine.info.shape, finer=4)
    assert told == notices
    for one in (view, fine):
        assert one.mask is not None
        assert one.image[:, one.mask].min() > 85 / 255
    kept = fine.mask.sum(axis=0)
    assert kept[0] != kept[len(kept) // 2]


def test_a_scene_of_barred_photographs_has_nothing_of_the_bars(engine, plane_scene) -> None:
    """Not even of their colour."""
    black, white = (
        Reconstructor(engine).reconstruct(
            [barred(image, "rows", 9, colour) for image in plane_scene.images], plane_scene.cameras, near=2, far=8
        )
        for colour in (BLACK, WHITE)
    )
    for scene in (black, white):
        told = [notice for notice in scene.document["warnings"] if notice["code"] == "border_left_out"]
        assert [notice["index"] for notice in told] == [0, 1, 2]
        assert MASKED in {row["reason"] for row in scene.document["dropped"]}
    for picture in black.inputs:
        rows = picture[:, :, 3].any(axis=1)
        assert not rows[:6].any()
        assert not rows[-6:].any()
        assert rows[8:-8].all()
    np.testing.assert_array_equal(black.gaussians.means, white.gaussians.means)
    np.testing.assert_array_equal(black.gaussians.harmonics, white.gaussians.harmonics)
    np.testing.assert_array_equal(black.gaussians.opacities, white.gaussians.opacities)


def test_bars_of_one_photograph_cost_little() -> None:
    """From between the inputs: 32.7 dB without bars, 19.4 where they are taken for content."""
    truth, cameras = sample_pixels(2) / 255.0, sample_cameras((1, 2, 3))
    images = [barred(sample_pixels(1), "rows", 30, BLACK), sample_pixels(3)]
    scene = Reconstructor(threads=1).reconstruct(images, [cameras[0], cameras[2]], near=NEAR, far=FAR)
    assert [notice["index"] for notice in scene.document["warnings"] if notice["code"] == "border_left_out"] == [0]
    psnr = -10 * np.log10(((scene.render(cameras[1]).rgb - truth) ** 2).mean())
    assert psnr > 31  # measured 31.5
