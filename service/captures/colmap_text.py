"""Reader of COLMAP's text files, line by line, with comments, empty lines and names with spaces."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import BinaryIO, TypeVar

import numpy as np

from ..errors import CameraError
from .colmap_model import (
    IDENTITY,
    MAX_POINTS,
    MODELS,
    SENSORS,
    ColmapCamera,
    ColmapFrame,
    ColmapImage,
    Points,
    PointsSoFar,
    Sensor,
    repeated_id,
)
from .table import MAX_LISTED

_Entry = TypeVar("_Entry")
_Parsed = TypeVar("_Parsed")

_LONGEST_LINE = 2**20  # bytes of a parsed line; lines of points may be longer
_MOST_LINES = 4 * MAX_LISTED  # parsed or passed over: two for each image, and comments
_MARK = "\ufeff"  # byte order mark, written by some editors
_LONGEST_IMAGE = 2**13  # bytes of the line of an image; a longer line holds points
_POINT = 8  # columns of a point before its images: id, x, y, z, red, green, blue and error
_PARAMS = {name: count for name, count in MODELS.values()}


def read_cameras(stream: BinaryIO, source: str) -> dict[int, ColmapCamera]:
    """Cameras of a cameras.txt by id. Raises `CameraError`."""

    def camera(words: list[str]) -> tuple[int, ColmapCamera]:
        model, params = words[1], tuple(map(float, words[4:]))
        if model not in _PARAMS or len(params) != _PARAMS[model]:
            need = f"need {_PARAMS[model]}" if model in _PARAMS else f"need one of {', '.join(_PARAMS)}"
            raise ValueError(f"camera model {model} with {len(params)} parameters, {need}")
        return int(words[0]), ColmapCamera(model, int(words[2]), int(words[3]), params)

    return _entries(_lines(stream, source), source, camera)


def read_images(stream: BinaryIO, source: str) -> dict[int, ColmapImage]:
    """Images of an images.txt by id. Each has a second line with points, which may be empty, or missing in a file that
    was written by hand. Raises `CameraError`."""

    def image(words: list[str]) -> tuple[int, ColmapImage]:
        if len(words) != 10:
            raise ValueError(f"an image has {len(words)} columns, need 10")
        image_id, *pose, camera_id, name = words
        return int(image_id), ColmapImage(name, int(camera_id), tuple(map(float, pose)))

    return _entries(_lines(stream, source, every_second=True), source, image, most=10)


def read_rigs(stream: BinaryIO, source: str) -> dict[int, dict[Sensor, tuple[float, ...] | None]]:
    """Rigs of a rigs.txt by id: the reference sensor, and each other with or without its pose. Raises `CameraError`."""

    total = _Total()

    def rig(words: list[str]) -> tuple[int, dict[Sensor, tuple[float, ...] | None]]:
        rest = iter(words[2:])
        sensors: dict[Sensor, tuple[float, ...] | None] = {}
        for place in range(total.with_more(words[1])):
            sensor = _sensor(rest)
            if place == 0:
                sensors[sensor] = IDENTITY
            else:
                sensors[sensor] = _floats(rest, 7) if int(next(rest)) else None
        return int(words[0]), sensors

    return _entries(_lines(stream, source), source, rig)


def read_frames(stream: BinaryIO, source: str) -> dict[int, ColmapFrame]:
    """Frames of a frames.txt by id: rig, its pose, and images with their sensors. Raises `CameraError`."""

    total = _Total()

    def frame(words: list[str]) -> tuple[int, ColmapFrame]:
        rest = iter(words[9:])
        images = tuple((_sensor(rest), int(next(rest))) for _ in range(total.with_more(next(rest))))
        return int(words[0]), ColmapFrame(int(words[1]), _floats(iter(words[2:]), 7), images)

    return _entries(_lines(stream, source), source, frame)


def read_points(stream: BinaryIO, source: str) -> Points:
    """Points of a points3D.txt. Raises `CameraError`, also above the limits of `check_points`."""

    def point(words: list[str]) -> tuple[list[float], list[int]]:
        if len(words) < _POINT or len(words) % 2:
            raise ValueError(f"a point has {len(words)} columns, need {_POINT} and two for each of its images")
        images = [int(word) for word in words[_POINT::2]]
        if any(not 0 <= image < 2**32 for image in images):
            raise ValueError("an image's number is not from 0 to 4294967295")
        return [float(words[column]) for column in (1, 2, 3, 7)], images

    found = PointsSoFar(source)
    for _, (row, images) in _parsed(_lines(stream, source, most=2 * MAX_POINTS), source, point):
        found.add(row, np.array(images, dtype=np.uint32))
    return found.points()


def _entries(
    lines: Iterator[tuple[int, str]],
    source: str,
    parse: Callable[[list[str]], tuple[int, _Entry]],
    most: int = 0,
) -> dict[int, _Entry]:
    """Parsed lines by id; with `most` columns the last may contain spaces. Raises `CameraError` naming the line."""
    entries: dict[int, _Entry] = {}
    for number, (key, entry) in _parsed(lines, source, parse, most):
        if key in entries:
            raise repeated_id(f"{source}, line {number}", key)
        entries[key] = entry
        if len(entries) > MAX_LISTED:
            message = f"{source} lists more than {MAX_LISTED} entries, the limit"
            raise CameraError(message, field="cameras", cure="leave out the images that are not to be used")
    return entries


def _parsed(
    lines: Iterator[tuple[int, str]], source: str, parse: Callable[[list[str]], _Parsed], most: int = 0
) -> Iterator[tuple[int, _Parsed]]:
    """Numbers of lines, and these parsed one by one; with `most` columns the last may contain spaces. Raises
    `CameraError` naming the line."""
    for number, line in lines:
        try:
            parsed = parse(line.split(maxsplit=most - 1))
        except (ValueError, IndexError, StopIteration, RuntimeError, OverflowError) as error:
            reason = f"{error!s:.200}" if isinstance(error, ValueError) else "has too few columns"
            cure = "is it a file of COLMAP, and complete?"
            raise CameraError(f"{source}, line {number}: {reason}", field="cameras", cure=cure) from error
        yield number, parsed


def _lines(
    stream: BinaryIO, source: str, *, every_second: bool = False, most: int = _MOST_LINES
) -> Iterator[tuple[int, str]]:
    """Number and text of lines that are neither empty nor comments, of `most` at most; with `every_second` the line of
    points after each is skipped."""
    number, data = 0, b""
    while data := data or stream.readline(_LONGEST_LINE):
        number += 1
        if number > most:
            message = f"{source} has more than {most} lines"
            raise CameraError(
                message, field="cameras", cure="is it a file of COLMAP? leave out empty lines and comments"
            )
        if len(data) == _LONGEST_LINE and not data.endswith(b"\n"):
            message = f"{source}, line {number} has more than {_LONGEST_LINE} bytes"
            raise CameraError(message, field="cameras", cure="is it a file of COLMAP?")
        line, data = data.decode("utf-8", "replace").lstrip(_MARK).strip(), b""
        if not line or line.startswith("#"):
            continue
        yield number, line
        if every_second:
            below = stream.readline(_LONGEST_LINE)
            if not _has_points(below):
                data = below
                continue
            number += 1
            while len(below) == _LONGEST_LINE and not below.endswith(b"\n"):
                below = stream.readline(_LONGEST_LINE)


def _has_points(line: bytes) -> bool:
    """Whether a line holds points, triples of numbers or nothing; otherwise it is the next image."""
    if len(line) > _LONGEST_IMAGE:
        return True
    words = line.split()
    try:
        return len(list(map(float, words))) % 3 == 0
    except ValueError:
        return False


def _sensor(words: Iterator[str]) -> Sensor:
    kind, number = next(words), next(words)
    if kind not in SENSORS:
        raise ValueError(f"sensor {kind!r}, need one of {', '.join(SENSORS)}")
    return SENSORS.index(kind), int(number)


def _floats(words: Iterator[str], count: int) -> tuple[float, ...]:
    return tuple(float(next(words)) for _ in range(count))


class _Total:
    """Sum of the counts that lines announce, with a limit."""

    def __init__(self) -> None:
        self._sum = 0

    def with_more(self, word: str) -> int:
        """The count, added to the sum. Raises `ValueError` if it is negative or the sum exceeds the limit."""
        count = int(word)
        self._sum += count
        if count < 0 or self._sum > MAX_LISTED:
            raise ValueError(f"a count of {count}, {self._sum} with those before it, the limit is {MAX_LISTED}")
        return count
