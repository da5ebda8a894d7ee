"""Films decoded again: all frames, in order, at their times and like the drawn ones; memory for one frame."""

from __future__ import annotations

import weakref
from collections.abc import Iterator
from fractions import Fraction
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image, ImageSequence

from gapmes.service.errors import InputError
from gapmes.service.pictures import film
from gapmes.service.pictures.film import FILM_FORMATS, FilmShape, check_film, most_frames, times_ms, write_film
from gapmes.service.pictures.picture_error import psnr

WIDTH, HEIGHT, FRAMES, SECONDS = 96, 64, 12, 1.0
# dB of the worst frame of `drawn`; measured 34.9, 35.6 and 35.9. What WebP and MP4 have at half the resolution, colour,
# costs most at the disc's edge
LEAST_PSNR = {"webp": 34.0, "gif": 34.5, "mp4": 35.0}

needs_av = pytest.mark.skipif(find_spec("av") is None, reason="pip install 'gapmes[video]'")
FORMATS = [pytest.param(name, marks=needs_av if name == "mp4" else ()) for name in FILM_FORMATS]


def drawn(number: int) -> np.ndarray:
    """A disc on a gradient; it moves with the number, which the brightness of the lower edge says too."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    red, green = x / WIDTH, y / HEIGHT
    disc = 1 / (1 + np.exp((np.hypot(x - 8 * number, y - 30) - 14) / 2))
    picture = np.stack([red, green, 0.3 + 0 * x], axis=-1) * (1 - disc[..., None]) + disc[..., None] * (0.9, 0.8, 0.1)
    picture[-8:] = number / FRAMES
    return np.rint(255 * picture).astype(np.uint8)


def shape(format: Any, **changes: Any) -> FilmShape:
    usual = {"width": WIDTH, "height": HEIGHT, "frames": FRAMES, "seconds": SECONDS}
    return FilmShape(format, **usual | changes)


def decoded(path: Path) -> list[np.ndarray]:
    if path.suffix == ".mp4":
        import av

        with av.open(str(path)) as container:
            return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    with Image.open(path) as image:
        return [np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(image)]


def planes(pixels: np.ndarray) -> np.ndarray:
    return (pixels.astype(np.float64) / 255).transpose(2, 0, 1)


@pytest.mark.parametrize("format", FORMATS)
def test_every_frame_comes_back(format: Any, tmp_path: Path) -> None:
    path = tmp_path / f"film.{format}"
    write_film(path, shape(format), map(drawn, range(FRAMES)))
    found = decoded(path)
    assert len(found) == FRAMES
    for number, pixels in enumerate(found):
        assert pixels.shape == (HEIGHT, WIDTH, 3)
        scores = [psnr(planes(pixels), planes(drawn(other))) for other in range(FRAMES)]
        assert int(np.argmax(scores)) == number
        assert scores[number] >= LEAST_PSNR[format]
    assert list(tmp_path.iterdir()) == [path]


def times_of(path: Path) -> list[int]:
    """The duration of each frame in ms, of a film that loops."""
    with Image.open(path) as image:
        assert image.info["loop"] == 0
        times = []
        for frame in ImageSequence.Iterator(image):
            frame.load()
            times.append(frame.info["duration"])
    return times


@pytest.mark.parametrize("format", ["webp", "gif"])
def test_pictures_that_move_say_how_long_and_begin_anew(format: Any, tmp_path: Path) -> None:
    path = tmp_path / f"film.{format}"
    write_film(path, shape(format, seconds=0.7), map(drawn, range(FRAMES)))
    times = times_of(path)
    assert sum(times) == 700
    assert max(times) - min(times) <= film.UNIT_MS[format]


@pytest.mark.parametrize(("format", "unit"), [("webp", 1), ("gif", 10)])
def test_each_frame_lasts_as_long_as_its_format_can_tell(format: Any, unit: int, tmp_path: Path) -> None:
    """58.3 ms each."""
    path = tmp_path / f"film.{format}"
    write_film(path, shape(format, seconds=0.7), map(drawn, range(FRAMES)))
    assert all(abs(time - 700 / FRAMES) < unit for time in times_of(path))


def test_a_still_film_of_an_odd_time_loses_none_of_it(tmp_path: Path) -> None:
    path = tmp_path / "film.webp"
    write_film(path, shape("webp", seconds=0.711), [drawn(3)] * FRAMES)
    assert times_of(path) == [355, 356]


@needs_av
def test_mp4_has_any_rate(tmp_path: Path) -> None:
    import av

    path = tmp_path / "film.mp4"
    write_film(path, shape("mp4", seconds=0.7), map(drawn, range(FRAMES)))
    with av.open(str(path)) as container:
        assert container.streams.video[0].average_rate == Fraction(120, 7)
        assert container.duration == pytest.approx(700_000, abs=1000)


@pytest.mark.parametrize("level", [None, 77], ids=["picture", "grey"])
@pytest.mark.parametrize("format", ["webp", "gif"])
def test_a_film_in_which_nothing_moves_is_one(format: Any, level: int | None, tmp_path: Path) -> None:
    """Encoders keep equal neighbours as one, and would make a still of it, which has no time."""
    picture = drawn(3) if level is None else np.full((HEIGHT, WIDTH, 3), level, np.uint8)
    path = tmp_path / f"film.{format}"
    write_film(path, shape(format, seconds=0.71), [picture] * FRAMES)
    found = decoded(path)
    assert len(found) >= 2
    for pixels in found:
        assert pixels.shape == (HEIGHT, WIDTH, 3)
        assert psnr(planes(pixels), planes(picture)) >= LEAST_PSNR[format]
    times = times_of(path)
    assert sum(times) == 710


@needs_av
def test_mp4_is_what_browsers_play(tmp_path: Path) -> None:
    import av

    path = tmp_path / "film.mp4"
    write_film(path, shape("mp4", seconds=0.5), map(drawn, range(FRAMES)))
    data = path.read_bytes()
    assert data[4:8] == b"ftyp"
    assert data.index(b"moov") < data.index(b"mdat")  # plays while it is loaded
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        context = stream.codec_context
        assert (context.name, context.pix_fmt, stream.average_rate) == ("h264", "yuv420p", 24)
        assert (context.colorspace, context.color_primaries, context.color_trc) == (1, 1, 1)
        assert container.duration == 500_000  # microseconds


@pytest.mark.parametrize("format", FORMATS)
def test_frames_are_not_collected(format: Any, tmp_path: Path) -> None:
    """Of the frames that were drawn two are in memory at most: one in the encoder's hands, and the next."""
    alive: list[weakref.ref] = []
    most = 0

    def frames() -> Iterator[np.ndarray]:
        nonlocal most
        for number in range(60):
            pixels = drawn(number % FRAMES)
            alive.append(weakref.ref(pixels))
            most = max(most, sum(one() is not None for one in alive))
            yield pixels
            del pixels

    write_film(tmp_path / f"film.{format}", shape(format, frames=60, seconds=3.0), frames())
    assert len(alive) == 60
    assert most <= 2


class Left(Exception):
    pass


@pytest.mark.parametrize("format", FORMATS)
def test_what_ends_the_frames_leaves_nothing(format: Any, tmp_path: Path) -> None:
    def frames(count: int) -> Iterator[np.ndarray]:
        yield from map(drawn, range(count))
        raise Left

    path = tmp_path / f"film.{format}"
    path.write_bytes(b"before")
    for count in (0, 1, 5):
        with pytest.raises(Left):
            write_film(path, shape(format), frames(count))
    for count in (FRAMES - 1, FRAMES + 1):
        with pytest.raises(ValueError, match="frames, the film has 12"):
            write_film(path, shape(format), map(drawn, range(count)))
    with pytest.raises(ValueError, match="frame 0 has shape"):
        write_film(path, shape(format, width=98), map(drawn, range(FRAMES)))
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


@given(frames=st.integers(2, 400), fps=st.floats(1, 50), unit=st.sampled_from([1, 10]))
def test_times_add_up(frames: int, fps: float, unit: int) -> None:
    times = times_ms(FilmShape("gif", 8, 8, frames, frames / fps), unit)
    assert len(times) == frames
    assert abs(sum(times) - 1000 * frames / fps) <= unit / 2 + 1e-6
    assert min(times) >= 1000 / fps - unit
    assert max(times) <= 1000 / fps + unit


def test_as_many_frames_fit_as_the_rate_allows() -> None:
    """Also where 50 times the seconds is just below a whole number of float64."""
    for frames in range(2, 30_001):
        assert most_frames(frames / 50) == frames
        assert most_frames((frames + 0.5) / 50) == frames
        check_film(shape("gif", frames=frames, seconds=frames / 50))


@pytest.mark.parametrize(
    ("format", "changes", "field", "words"),
    [
        ("webp", {"frames": 1}, "frames", "1 is no film, need 2"),
        ("gif", {"frames": 51}, "seconds", "51 frames in 1 s are 51 per second, the limit is 50"),
        ("webp", {"width": 16384}, "width", "16384 px, the limit of webp is 16383"),
        ("gif", {"height": 65536}, "height", "65536 px, the limit of gif is 65535"),
        pytest.param("mp4", {"width": 97}, "width", "97 px, MP4 needs an even number", marks=needs_av),
        pytest.param("mp4", {"height": 8194}, "height", "8194 px, the limit of mp4 is 8192", marks=needs_av),
    ],
)
def test_what_cannot_be_written_is_refused(format: Any, changes: dict[str, Any], field: str, words: str) -> None:
    check_film(shape(format))
    with pytest.raises(InputError) as caught:
        check_film(shape(format, **changes))
    assert caught.value.field == field
    assert words in caught.value.message


def test_without_its_library_mp4_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(film, "find_spec", lambda _: None)
    check_film(shape("webp"))
    with pytest.raises(InputError) as caught:
        check_film(shape("mp4"))
    assert "gapmes[video]" in (caught.value.cure or "")


@needs_av
def test_without_its_encoder_mp4_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from gapmes.service.pictures import film_mp4

    monkeypatch.setattr(film_mp4, "ENCODER", "no such encoder")
    with pytest.raises(InputError, match="has no no such encoder"):
        write_film(tmp_path / "film.mp4", shape("mp4"), map(drawn, range(FRAMES)))
