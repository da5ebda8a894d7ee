"""A third reader and writer, PlayCanvas' splat-transform, agrees on every format and on the frame of a .spz.

It is a program of npm: `npm install -g @playcanvas/splat-transform` puts it on the path, without which nothing is run.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from format_cases import moderate, rotation_distance

from gapmes.service import read_gaussians, write_gaussians
from gapmes.service.formats.morton import morton_order
from gapmes.service.formats.registry import FORMATS
from gapmes.service.gaussians import Gaussians

PROGRAM = shutil.which("splat-transform")
pytestmark = pytest.mark.skipif(PROGRAM is None, reason="splat-transform is not on the path: npm has it")
# Of one unit in sizes and positions that span about four; the .spz of version 3 has 1/4096 and e^(1/32) by its own
# choice, harmonics of 5 and 4 bits; the .splat's rotations are read in 255 levels by one and 256 by the other.
POSITION, LOG_SCALE, ROTATION, OPACITY, COLOUR, BAND = 4e-3, 1 / 32 + 1e-5, 0.01, 1 / 250, 1 / 70, 0.07


def transformed(source: Path, target: Path) -> None:
    options = ["--spz-version", "3"] if target.suffix == ".spz" else []
    command = [str(PROGRAM), "-q", "-w", *options, str(source), str(target)]
    subprocess.run(command, check=True, capture_output=True, timeout=120)


def agree(found: Gaussians, source: Gaussians, *, bands: bool) -> None:
    """By nearest position, since some writers sort."""
    found, source = found[morton_order(found.means.round(2))], source[morton_order(source.means.round(2))]
    nearest = np.abs(found.means[:, None] - source.means[None]).max(axis=2).argmin(axis=1)
    assert len(set(nearest.tolist())) == len(source) == len(found)
    source = source[nearest]
    assert np.abs(found.means - source.means).max() <= POSITION
    assert np.abs(np.log(found.scales / source.scales)).max() <= LOG_SCALE
    assert rotation_distance(found.rotations_wxyz, source.rotations_wxyz).max() <= ROTATION
    assert np.abs(found.opacities - source.opacities).max() <= OPACITY
    assert np.abs(found.harmonics[:, 0] - source.harmonics[:, 0]).max() <= COLOUR
    if bands:
        assert np.abs(found.harmonics - source.harmonics).max() <= BAND


@pytest.mark.parametrize("name", FORMATS)
def test_it_reads_what_we_write(tmp_path: Path, name: str) -> None:
    source = moderate(150, 3, 2)
    path, back = tmp_path / f"ours.{name}", tmp_path / "back.ply"
    write_gaussians(path, source)
    transformed(path, back)
    agree(read_gaussians(back), source, bands=name != "splat")


@pytest.mark.parametrize("name", [name for name in FORMATS if name != "splat"])  # which it does not write
def test_we_read_what_it_writes(tmp_path: Path, name: str) -> None:
    source = moderate(150, 4, 2)
    first, path = tmp_path / "ours.ply", tmp_path / f"theirs.{name}"
    write_gaussians(first, source)
    transformed(first, path)
    agree(read_gaussians(path), source, bands=True)
