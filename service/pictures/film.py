"""Writing films as WebP and GIF by Pillow or as MP4 by PyAV, frame by frame."""

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

MAX_SIDE: dict[FilmFormat, int] = {"webp": 16_383, "gif": 65_535, "mp4": 8_192}  # px; for MP4 a limit of players
MAX_FPS = 50.0  # browsers show GIF and WebP frames of less than 0.02 s slowly
UNIT_MS: dict[str, int] = {"webp": 1, "gif": 10}  # unit of a frame's duration in the format
_WEBP: dict[str, Any] = {"quality": 80, "method": 2}

Pixels = NDArray[np.uint8]  # (H, W, 3) sRGB


@dataclass(frozen=True)
class FilmShape:
    """Format, size and length of a film, to be checked by `check_film`."""

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
    """Raises `InputError` for a film that `write_film` could not write, before anything is drawn."""
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
    """The largest number of frames that `MAX_FPS` allows, tolerant of float64 rounding."""
    return math.floor(MAX_FPS * seconds * (1 + 1e-12))


def write_film(path: Path, shape: FilmShape, frames: Iterable[Pixels]) -> None:
    """Write `shape.frames` frames as a film that loops (MP4: as the player is set). `path` is replaced atomically;
    exceptions of the iterable pass, and leave no file.

    One frame is in memory at a time, beside what a WebP or MP4 encoder has compressed.
    """
    counted = _counted(frames, shape)
    with replacing(path) as part:
        WRITERS[shape.format](part, shape, counted)
        for _ in counted:  # checks the count if the writer stopped at the expected one
            pass


def times_ms(shape: FilmShape, unit: int) -> list[int]:
    """Duration of each frame in ms, in multiples of `unit`, without accumulating rounding errors."""
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
    """A multi-frame image for Pillow whose frames are made when they are read."""

    def __init__(self, shape: FilmShape, frames: Iterator[Pixels]) -> None:
        super().__init__()
        self._frames, self._at = frames, -1
        self.n_frames = shape.frames
        self.seek(0)

    def tell(self) -> int:
        return self._at

    def seek(self, frame: int) -> None:
        """Load the next frame. Pillow seeks back to the first one only after the last, which is ignored."""
        if frame > self._at:
            picture = Image.fromarray(next(self._frames))
            self.im, self._mode, self._size, self._at = picture.im, picture.mode, picture.size, frame


def _write_webp(path: Path, shape: FilmShape, frames: Iterator[Pixels]) -> None:
    times = times_ms(shape, UNIT_MS["webp"])
    _Reel(shape, frames).save(path, "WEBP", save_all=True, duration=times, loop=0, **_WEBP)
    keep_moving(path, shape.width, shape.height, sum(times))


def _write_gif(path: Path, shape: FilmShape, frames: Iterator[Pixels]) -> None:
    """Write frame by frame, each with a palette of its own; Pillow's `save_all` would keep all frames in memory."""
    first = _indexed(next(frames))
    with path.open("wb") as file:
        file.writelines(GifImagePlugin.getheader(first.copy(), info={"loop": 0})[0])
        pictures = chain([first], map(_indexed, frames))
        for picture, time in zip(pictures, times_ms(shape, UNIT_MS["gif"]), strict=False):
            file.writelines(GifImagePlugin.getdata(picture, duration=time, include_color_table=True))
        file.write(b";")


def _indexed(pixels: Pixels) -> Image.Image:
    """The frame with an octree palette, which takes a hundredth of the time of median cut at equal quality."""
    picture = Image.fromarray(pixels)
    palette = picture.quantize(256, Image.Quantize.FASTOCTREE)
    return picture.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG)


def _write_mp4(path: Path, shape: FilmShape, frames: Iterator[Pixels]) -> None:
    from .film_mp4 import write_mp4

    write_mp4(path, shape.width, shape.height, shape.fps, frames)


WRITERS = {"webp": _write_webp, "gif": _write_gif, "mp4": _write_mp4}
