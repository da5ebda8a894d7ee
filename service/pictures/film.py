"""Moving pictures as files: WebP and GIF by Pillow, MP4 by PyAV; frames go into the encoder one by one."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from PIL import GifImagePlugin, Image

from ..errors import InputError
from ..process.disk import replacing
from .film_webp import keep_moving

FilmFormat = Literal["webp", "gif", "mp4"]
FILM_FORMATS: tuple[FilmFormat, ...] = get_args(FilmFormat)
MEDIA_TYPES: dict[FilmFormat, str] = {"webp": "image/webp", "gif": "image/gif", "mp4": "video/mp4"}

MAX_SIDE: dict[FilmFormat, int] = {"webp": 16_383, "gif": 65_535, "mp4": 8_192}  # px; for MP4 what players can be asked
MAX_FPS = 50.0  # browsers show GIF and WebP frames of less than 0.02 s slowly
UNIT_MS: dict[str, int] = {"webp": 1, "gif": 10}  # in which the format counts a frame's time
_WEBP: dict[str, Any] = {"quality": 80, "method": 2}

Pixels = NDArray[np.uint8]  # (H, W, 3) sRGB


@dataclass(frozen=True)
class FilmShape:
    """What a film is like; `check_film` refuses what cannot be written."""

    format: FilmFormat
    width: int  # px
    height: int  # px
    frames: int
    seconds: float

    @property
    def fps(self) -> float:
        """Frames per second."""
        return self.frames / self.seconds


def check_film(shape: FilmShape) -> None:
    """Refuse what `write_film` could not write, before anything is drawn. Raises `InputError`."""
    if shape.format == "mp4" and find_spec("av") is None:
        raise InputError("MP4 needs PyAV here", field="format", cure="pip install 'gapmes[video]', or ask for webp")
    if shape.frames < 2:
        raise InputError(f"{shape.frames} is no film, need 2 or more", field="frames", cure="ask for more seconds")
    if not 0 < shape.frames <= most_frames(shape.seconds):
        raise InputError(
            f"{shape.frames} frames in {shape.seconds:g} s are {shape.fps:.4g} per second, the limit is {MAX_FPS:g}",
            field="seconds",
            cure="ask for fewer frames, or more seconds",
        )
    for field, side in (("width", shape.width), ("height", shape.height)):
        if side > MAX_SIDE[shape.format]:
            raise InputError(f"{side} px, the limit of {shape.format} is {MAX_SIDE[shape.format]}", field=field)
        if shape.format == "mp4" and side % 2:
            raise InputError(f"{side} px, MP4 needs an even number", field=field, cure=f"ask for {side + 1}")


def most_frames(seconds: float) -> int:
    """As many as `MAX_FPS` allows; a product that is a whole number but for float64's rounding is that number."""
    return math.floor(MAX_FPS * seconds * (1 + 1e-12))


def write_film(path: Path, shape: FilmShape, frames: Iterable[Pixels]) -> None:
    """Write `frames`, of which there must be `shape.frames`, as a film that begins anew when it ends (MP4: as the
    player is told). It takes the place of what is at `path` when it is whole; what the iterable raises ends it.

    One frame is held at a time; a WebP or MP4 encoder keeps what it has compressed.
    """
    counted = _counted(frames, shape)
    with replacing(path) as part:
        WRITERS[shape.format](part, shape, counted)
        for _ in counted:  # counts what a writer that knows their number has left
            pass


def times_ms(shape: FilmShape, unit: int) -> list[int]:
    """How long each frame is shown, in whole `unit`s that add up to the film's seconds: no error builds up."""
    ends = np.rint(np.arange(shape.frames + 1) * (1000 * shape.seconds / shape.frames / unit)).astype(int)
    return [int(time) * unit for time in np.diff(ends)]


def _counted(frames: Iterable[Pixels], shape: FilmShape) -> Iterator[Pixels]:
    count = 0
    for pixels in frames:
        if pixels.shape != (shape.height, shape.width, 3):
            raise ValueError(f"frame {count} has shape {pixels.shape}, not that of the film")
        count += 1
        yield pixels
    if count != shape.frames:
        raise ValueError(f"{count} frames, the film has {shape.frames}")


class _Reel(Image.Image):
    """Pillow's form of a picture of many frames, each made when it is asked for."""

    def __init__(self, shape: FilmShape, frames: Iterator[Pixels]) -> None:
        super().__init__()
        self._frames, self._at = frames, -1
        self.n_frames = shape.frames
        self.seek(0)

    def tell(self) -> int:
        return self._at

    def seek(self, frame: int) -> None:
        """The next frame; Pillow goes back to the first one when it has done with all, which nothing comes after."""
        if frame > self._at:
            picture = Image.fromarray(next(self._frames))
            self.im, self._mode, self._size, self._at = picture.im, picture.mode, picture.size, frame


def _write_webp(path: Path, shape: FilmShape, frames: Iterator[Pixels]) -> None:
    times = times_ms(shape, UNIT_MS["webp"])
    _Reel(shape, frames).save(path, "WEBP", save_all=True, duration=times, loop=0, **_WEBP)
    keep_moving(path, shape.width, shape.height, sum(times))


def _write_gif(path: Path, shape: FilmShape, frames: Iterator[Pixels]) -> None:
    """Frame by frame, each with 256 colours of its own: Pillow's own `save_all` keeps all of them until the end."""
    first = _indexed(next(frames))
    with path.open("wb") as file:
        file.writelines(GifImagePlugin.getheader(first.copy(), info={"loop": 0})[0])
        pictures = chain([first], map(_indexed, frames))
        for picture, time in zip(pictures, times_ms(shape, UNIT_MS["gif"]), strict=False):
            file.writelines(GifImagePlugin.getdata(picture, duration=time, include_color_table=True))
        file.write(b";")


def _indexed(pixels: Pixels) -> Image.Image:
    """The octree's palette is found in a hundredth of the time of the median cut's, and its pictures are no worse."""
    picture = Image.fromarray(pixels)
    palette = picture.quantize(256, Image.Quantize.FASTOCTREE)
    return picture.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG)


def _write_mp4(path: Path, shape: FilmShape, frames: Iterator[Pixels]) -> None:
    from .film_mp4 import write_mp4

    write_mp4(path, shape.width, shape.height, shape.fps, frames)


WRITERS = {"webp": _write_webp, "gif": _write_gif, "mp4": _write_mp4}
