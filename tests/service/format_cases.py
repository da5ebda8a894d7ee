"""Files of each format written by hand, and helpers of the format tests."""

from __future__ import annotations

import gzip
import struct
from pathlib import Path

import numpy as np
from gsply import GSData, plyread
from gsply.spz import read_spz as gsply_read_spz
from ply_cases import gaussians

from gapmes.service.formats.morton import morton_order
from gapmes.service.formats.registry import FORMATS, read_gaussians
from gapmes.service.gaussians import Gaussians
from gapmes.service.harmonics import C0, band_rotations

SIDES = {"compressed.ply": "scene.compressed.ply", "splat": "scene.splat", "spz": "scene.spz", "ply": "scene.ply"}
ROUNDING = 1e-6  # of the float32 numbers that `Gaussians` holds


def moderate(count: int = 700, seed: int = 0, degree: int = 3) -> Gaussians:
    """Gaussians whose colours and harmonics lie within what every format holds."""
    base, rng = gaussians(count, seed, degree), np.random.default_rng(seed + 1)
    harmonics = rng.uniform(-0.95, 0.95, base.harmonics.shape)
    return Gaussians.make(base.means, base.scales, base.rotations_wxyz, base.opacities, harmonics)


def whole_range(name: str, count: int, seed: int = 0, degree: int = 3) -> Gaussians:
    """Gaussians whose sizes, colours and harmonics reach both ends of what a format says that it holds."""
    base, rng = gaussians(count, seed, degree), np.random.default_rng(seed + 1)
    colour, low, high, sizes = {
        "compressed.ply": (9.0, -4.0, 4.0, (2.1e-9, 4.8e8)),
        "splat": (0.5 / C0, -1.0, 1.0, (1e-38, 3e38)),
        "spz": (3.3, -1.0, 0.99, (4.5e-5, 379.0)),
    }[name]

    def reaching(low: float, high: float, shape: tuple[int, ...]) -> np.ndarray:
        """Half of the numbers evenly from end to end, a quarter near either."""
        near = 0.02 * (high - low) * rng.random(shape) ** 2
        return np.choose(rng.integers(0, 4, shape), [low + near, high - near, *rng.uniform(low, high, (2, *shape))])

    harmonics = reaching(low, high, base.harmonics.shape)
    if name == "spz":  # whose frame has y and z with another sign
        signs = np.concatenate([np.diag(band) for band in band_rotations(np.diag([1.0, -1.0, -1.0]), degree)])
        harmonics *= np.rint(signs)[:, None]
    harmonics[:, 0] = reaching(-colour, colour, (count, 3))
    scales = np.exp(reaching(*np.log(sizes), (count, 3)))
    return Gaussians.make(base.means, scales, base.rotations_wxyz, reaching(0, 1, (count,)), harmonics)


def there_and_back(source: Gaussians, name: str) -> tuple[Gaussians, Gaussians]:
    """The source in the order of the file's rows, and what the file holds."""
    ordered = source[morton_order(source.means)] if name == "compressed.ply" else source
    return ordered, read_gaussians(FORMATS[name].write(source).data, format=name)


def by_gsply(path: Path, data: bytes) -> Gaussians:
    """A file as gsply reads it, in the frame of the file."""
    path.write_bytes(data)
    found = gsply_read_spz(path) if path.suffix == ".spz" else plyread(path)
    return of_gsply(found)


def of_gsply(found: GSData) -> Gaussians:
    """The arrays of gsply, which hold log scales and logits."""
    constant = np.asarray(found.sh0, np.float64)[:, None, :]
    higher = np.zeros((len(constant), 0, 3)) if found.shN is None else np.asarray(found.shN, np.float64)
    return Gaussians.make(
        found.means,
        np.exp(np.asarray(found.scales, np.float64)),
        found.quats,
        1 / (1 + np.exp(-np.asarray(found.opacities, np.float64).ravel())),
        np.concatenate([constant, higher], axis=1),
    )


def to_gsply(source: Gaussians) -> GSData:
    """The arrays in gsply's form."""
    opacities = np.clip(source.opacities.astype(np.float64), 1e-6, 1 - 1e-6)
    return GSData.from_arrays(
        means=source.means.astype(np.float32),
        scales=np.log(source.scales),
        quats=source.rotations_wxyz,
        opacities=np.log(opacities / (1 - opacities)).astype(np.float32),
        sh0=source.harmonics[:, 0],
        shN=source.harmonics[:, 1:] if source.sh_degree else None,
        format="ply",
    )


def rotation_distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Largest component of the difference of unit quaternions, whose sign means nothing."""
    return np.minimum(np.abs(a - b).max(axis=1), np.abs(a + b).max(axis=1))


def spz_file(
    count: int = 2,
    *,
    version: int = 2,
    degree: int = 0,
    fraction: int = 12,
    magic: int = 0x5053474E,
    body: bytes | None = None,
    flags: int = 0,
) -> bytes:
    """A .spz whose columns are zero bytes unless a body is given."""
    row = 9 + 1 + 3 + 3 + (3 if version < 3 else 4) + 3 * ((degree + 1) ** 2 - 1)
    header = struct.pack("<IIIBBBB", magic, version, count, degree, fraction, flags, 0)
    return gzip.compress(header + (bytes(row * count) if body is None else body), mtime=0)
