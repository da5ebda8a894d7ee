"""Gaussians and .ply files built by hand, for the .ply tests."""

from __future__ import annotations

import io

import numpy as np
from plyfile import PlyData

from gapmes.service.gaussians import Gaussians

FIELDS = ("means", "scales", "rotations_wxyz", "opacities", "harmonics")


def gaussians(count: int = 20, seed: int = 0, degree: int = 3) -> Gaussians:
    """Gaussians in front of the origin whose means lie on the float32 grid."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(1, 4, count)
    means = np.stack([*(rng.uniform(-0.5, 0.5, (2, count)) * z), z], axis=1).astype(np.float32)
    return Gaussians.make(
        means,
        np.exp(rng.uniform(-5, -1, (count, 3))),
        rng.standard_normal((count, 4)),
        rng.uniform(0, 1, count),
        rng.normal(0, 0.5, (count, (degree + 1) ** 2, 3)),
    )


def columns(data: bytes) -> dict[str, np.ndarray]:
    """The vertex columns of a file, read by plyfile."""
    vertex = PlyData.read(io.BytesIO(data))["vertex"]
    return {prop.name: np.asarray(vertex[prop.name]) for prop in vertex.properties}


def binary_file(
    table: dict[str, np.ndarray], *, order: str = "<", before: bytes = b"", before_header: str = ""
) -> bytes:
    """A binary .ply with these columns in this order, written by hand."""
    words = {"f4": "float", "f8": "double", "u1": "uchar", "i4": "int"}
    kind = np.dtype([(name, order + column.dtype.str[1:]) for name, column in table.items()])
    rows = np.empty(len(next(iter(table.values()))), kind)
    for name, column in table.items():
        rows[name] = column
    name = "binary_little_endian" if order == "<" else "binary_big_endian"
    properties = "".join(f"property {words[c.dtype.str[1:]]} {n}\n" for n, c in table.items())
    header = f"ply\nformat {name} 1.0\n{before_header}element vertex {len(rows)}\n{properties}end_header\n"
    return header.encode() + before + rows.tobytes()


def assert_same(ours: Gaussians, other: Gaussians) -> None:
    """All fields bit for bit."""
    for field in FIELDS:
        assert getattr(ours, field).tobytes() == getattr(other, field).tobytes(), field
