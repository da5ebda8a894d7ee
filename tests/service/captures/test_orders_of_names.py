"""Which photograph belongs to which row where the names of neither tell: frames by number, LLFF's as text."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from capture_scenes import arc, llff_rows, photograph, realestate10k_text, zipped

from gapmes.service.captures.capture import open_capture
from gapmes.service.captures.select import ViewSelection

COUNT = 12


def realestate10k(root: Path) -> None:
    (root / "clip.txt").write_text(realestate10k_text(arc(COUNT)))


def llff(root: Path) -> None:
    np.save(root / "poses_bounds.npy", llff_rows(arc(COUNT)))


@pytest.mark.parametrize("packed", [False, True], ids=["folder", "zip"])
@pytest.mark.parametrize(
    ("write", "name", "by_number"),
    [
        (realestate10k, "{}.png", True),
        (realestate10k, "shot 2 frame {} of 12.jpg", True),
        (realestate10k, "frame_{:05d}.png", True),
        (llff, "{}.png", False),
        (llff, "{:03d}.png", True),
    ],
)
def test_rows_belong_to_photographs(
    tmp_path: Path, write: Callable[[Path], None], name: str, by_number: bool, packed: bool
) -> None:
    scene = tmp_path / "scene"
    (scene / "images").mkdir(parents=True)
    for number in range(COUNT):
        (scene / "images" / name.format(number)).write_bytes(photograph(number))
    write(scene)
    path = scene
    if packed:
        path = tmp_path / "scene.zip"
        path.write_bytes(zipped(scene))
    chosen = open_capture(path).choose(ViewSelection(select=",".join(map(str, range(COUNT)))))
    numbers = range(COUNT) if by_number else sorted(range(COUNT), key=str)
    assert chosen.paths == tuple(f"images/{name.format(number)}" for number in numbers)
    assert [chosen.read(place) for place in (2, 11)] == [photograph(numbers[place]) for place in (2, 11)]
