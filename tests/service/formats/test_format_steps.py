"""Every format reproduces each field to half a step, as docs/formats.md states."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from format_cases import ROUNDING, moderate, rotation_distance, there_and_back, whole_range

from gapmes.service.errors import FormatError
from gapmes.service.formats.compressed_ply import CHUNK
from gapmes.service.formats.encoded import typical_size
from gapmes.service.formats.registry import FORMATS
from gapmes.service.gaussians import Gaussians

COARSE = [name for name in FORMATS if name != "ply"]
PAGE = (Path(__file__).parents[3] / "docs" / "formats.md").read_text(encoding="utf-8")
STEP_10 = np.sqrt(2) / 1023  # of a smallest-three component in 10 bits
STEP_9 = np.sqrt(0.5) / 511  # and in a sign and 9 bits
# Of any component of a rotation. The one that is left out is off by up to three times the others, to first order; half
# a step in each of four, a whole one at +1, moves a unit quaternion by no more than their norm.
ROTATION = {
    "compressed.ply": 3.1 * STEP_10 / 2,
    "splat": np.sqrt(3 * (1 / 256) ** 2 + (1 / 128) ** 2),
    "spz": 3.1 * STEP_9 / 2,
}


def told(field: str, name: str) -> str:
    """What the page's table says of a field in a format."""
    rows = {row.split("|")[1].strip(): row.split("|")[2:-1] for row in PAGE.splitlines() if row.startswith("| ")}
    return dict(zip((cell.strip(" `") for cell in rows["field"]), rows[field], strict=True))[name]


def steps(field: str, name: str) -> list[float]:
    """Its fractions, or 0 for numbers that are held as they are."""
    found = re.findall(r"(\d+)/(\d+)", told(field, name))
    return [int(one) / int(other) for one, other in found] or [0.0]


def chunk_extents(values: np.ndarray) -> np.ndarray:
    """(N, 3) the extent of each row's chunk along each column."""
    starts = np.arange(0, len(values), CHUNK)
    extent = np.maximum.reduceat(values, starts) - np.minimum.reduceat(values, starts)
    return np.repeat(extent, CHUNK, axis=0)[: len(values)]


def share(error: np.ndarray, bound: np.ndarray | float) -> float:
    """The largest error as a share of its bound; the float32 of `Gaussians` rounds both."""
    return float((np.maximum(error - ROUNDING, 0) / np.maximum(bound, 1e-30)).max(initial=0.0))


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("count", [0, 1, 2, 256, 257, 700])
@pytest.mark.parametrize("name", COARSE)
def test_every_number_is_within_what_the_page_says_and_reaches_it(name: str, count: int, degree: int) -> None:
    """Also at both ends of the ranges that the page names."""
    before, after = there_and_back(whole_range(name, count, 3, degree), name)
    assert len(after) == count
    assert not any("are outside" in note for note in FORMATS[name].write(before).notes)
    if count == 0:
        return
    logs, position, size = np.log(before.scales.astype(float)), np.array(steps("position", name)), 0.0
    if name == "compressed.ply":
        wide, narrow = position
        place = chunk_extents(before.means) * [wide, narrow, wide]
        size = chunk_extents(logs) * [wide, narrow, wide]
        colour = chunk_extents(before.harmonics[:, 0]) * steps("colour (f_dc)", name)[0]
    else:
        place, size = position[0] * typical_size(before), steps("size", name)[0]
        colour = steps("colour (f_dc)", name)[0]
    rotations = rotation_distance(after.rotations_wxyz, before.rotations_wxyz)
    shares = {
        "position": share(np.abs(after.means - before.means), place),
        "size": share(np.abs(np.log(after.scales.astype(float)) - logs), size + 2 * ROUNDING),
        "opacity": share(np.abs(after.opacities - before.opacities), steps("opacity", name)[0]),
        "colour": share(np.abs(after.harmonics[:, 0] - before.harmonics[:, 0]), colour),
        "rotation": share(rotations, float(told("rotation", name).split(",")[0])),
    }
    assert after.sh_degree == (0 if name == "splat" else degree)
    if after.sh_degree:
        true, error = before.harmonics[:, 1:], np.abs(after.harmonics[:, 1:] - before.harmonics[:, 1:])
        step, *end = steps("higher harmonics", name)
        bound = np.where(np.abs(true) > 3.96, end[0], step) if end else step
        shares["higher harmonics"] = share(error, bound)
        assert share(error, end[0] if end else step) > 0.9 or count < 256
    assert max(shares.values()) <= 1, shares
    tight = {"opacity", "colour", *(() if name == "splat" else ("size", "higher harmonics"))}
    assert all(shares[field] > 0.9 for field in tight.intersection(shares)) or count < 256, shares


@pytest.mark.parametrize(("largest", "typical"), [([0.3, 0, 0.5, 0.9], 0.5), ([0, 0], 0), ([], 0)])
def test_a_typical_size_is_the_median_of_the_largest_that_are_not_zero(largest: list[float], typical: float) -> None:
    source = moderate(len(largest), 0, 0)
    source.scales[:] = np.array(largest, np.float32)[:, None] * [0, 1, 0.5]
    assert typical_size(source) == np.float32(typical)


def test_the_page_has_the_ranges_of_the_formats_and_the_bounds_of_rotations() -> None:
    assert "beyond ±3.96" in told("higher harmonics", "compressed.ply")
    for name, bound in ROTATION.items():
        assert told("rotation", name).split(",")[0].strip() == f"{np.ceil(1e4 * bound) / 1e4:.4f}"


@pytest.mark.parametrize("value", [3.953125, 3.96, 3.9765, 3.9766, 3.98, 3.999, 4.0, 5.0])
def test_harmonics_of_a_compressed_ply_become_the_nearest_byte_also_at_the_ends(value: float) -> None:
    """The first and the last byte mean -4 and 4, three quarters of a step from where an even scale had them."""
    decoded = np.concatenate([[-4.0], (np.arange(1, 255) + 0.5) / 32 - 4, [4.0]])
    source = moderate(2, 0, 1)
    source.harmonics[0, 1:], source.harmonics[1, 1:] = value, -value
    before, after = there_and_back(source, "compressed.ply")
    nearest = np.abs(before.harmonics[:, 1:, :, None] - decoded).min(axis=-1)
    assert np.abs(np.abs(after.harmonics - before.harmonics)[:, 1:] - nearest).max() <= ROUNDING
    assert nearest.max() <= 3 / 128 or value > 4


@pytest.mark.parametrize("x", [4194303.5, -4194303.5])
def test_the_farthest_position_of_spz_keeps_its_sign(x):
    """24 bits with one for halves hold less than 2^22; beyond it is refused, not wrapped round."""

    def one(at):
        return Gaussians.make([[at, 0, 0]], [[1000.0] * 3], [[1.0, 0, 0, 0]], [0.5], np.zeros((1, 1, 3)))

    assert there_and_back(one(x), "spz")[1].means[0, 0] == x
    with pytest.raises(FormatError):
        FORMATS["spz"].write(one(x + np.sign(x) * 0.5))
