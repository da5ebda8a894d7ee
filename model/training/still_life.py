"""The sample scene, composed by hand: a corner of a room with a table, a lamp, a plant and books, in metres."""

from __future__ import annotations

import math

import numpy as np

from . import patterns
from .primitives import BOX, CYLINDER, ELLIPSOID, ROOM, Background, Light, Primitive, World
from .rotations import euler
from .textures import TextureAtlas, mip_levels

# Name, pattern and seed of every texture; the order gives the index.
TEXTURES = (
    ("boards", patterns.wood, 9),
    ("floor", patterns.wood, 10),
    ("plaster", patterns.wall, 5),
    ("stone", patterns.bricks, 0),
    ("tiles", patterns.bricks, 2),
    ("poster", patterns.leaves, 1),
    ("print", patterns.leaves, 9),
    ("page", patterns.strokes, 0),
    ("cover", patterns.strokes, 1),
    ("rug", patterns.checker, 5),
    ("cloth", patterns.dots, 4),
    ("mosaic", patterns.voronoi, 9),
    ("glaze", patterns.voronoi, 10),
    ("marble", patterns.clouds, 8),
    ("peel", patterns.clouds, 1),
    ("shade", patterns.stripes, 8),
    ("foliage", patterns.clouds, 0),
    ("card", patterns.gradient, 1),
)
INDEX = {name: i for i, (name, _, _) in enumerate(TEXTURES)}
WHITE, WARM = (1.0, 1.0, 1.0), (1.0, 0.9, 0.75)


def still_life_atlas() -> TextureAtlas:
    """The textures of the scene alone."""
    rows = [
        mip_levels(np.clip(pattern(np.random.default_rng(seed)), 0, 1).astype(np.float32))
        for _, pattern, seed in TEXTURES
    ]
    return TextureAtlas(np.stack(rows), np.zeros(len(rows), np.bool_))


def _solid(kind, centre, half, texture, repeats, albedo=WHITE, yaw=0.0, gloss=0.0, rotation=None) -> Primitive:
    names = (texture,) * 6 if isinstance(texture, str) else texture
    return Primitive(
        kind,
        np.array(centre, np.float64),
        euler(0.0, math.radians(yaw), 0.0) if rotation is None else rotation,
        np.array(half, np.float64),
        np.array([INDEX[name] for name in names]),
        np.array([0.5, 0.5, repeats]),
        np.array(albedo, np.float64),
        gloss,
    )


def _table() -> list[Primitive]:
    top, legs = -0.72, []
    for x in (-0.62, 0.42):
        for z in (2.32, 2.88):
            legs.append(_solid(CYLINDER, (x, top / 2, z), (0.035, -top / 2, 0.035), "boards", 1.2, (0.8, 0.7, 0.65)))
    return [
        _solid(BOX, (-0.1, top - 0.02, 2.6), (0.62, 0.025, 0.38), "boards", 0.9, (1.3, 1.1, 0.95)),
        _solid(BOX, (-0.1, top - 0.049, 2.6), (0.2, 0.004, 0.384), "cloth", 1.8),
        *legs,
    ]


def _on_the_table() -> list[Primitive]:
    top = -0.765
    books = []
    for level, (texture, yaw, tint) in enumerate(
        (("card", 12.0, WHITE), ("cover", -6.0, (0.9, 1.0, 1.1)), ("page", 20.0, (1.0, 0.95, 0.8)))
    ):
        centre = (-0.48, top - 0.025 - 0.05 * level, 2.52)
        books.append(_solid(BOX, centre, (0.16, 0.024, 0.12), texture, 2.2, tint, yaw))
    return [
        *books,
        _solid(ELLIPSOID, (-0.47, top - 0.235, 2.5), (0.085, 0.085, 0.085), "mosaic", 2.0, WHITE, 30.0, 0.25),
        _solid(CYLINDER, (-0.14, top - 0.15, 2.7), (0.09, 0.15, 0.09), "glaze", 2.2, WHITE, 0.0, 0.2),
        _solid(CYLINDER, (-0.14, top - 0.31, 2.7), (0.045, 0.02, 0.045), "glaze", 2.2, (0.7, 0.6, 0.6), 0.0, 0.2),
        _solid(ELLIPSOID, (0.02, top - 0.075, 2.38), (0.08, 0.075, 0.08), "peel", 3.0, (1.25, 0.62, 0.2), 0.0, 0.2),
        _solid(ELLIPSOID, (0.18, top - 0.07, 2.46), (0.075, 0.07, 0.075), "peel", 3.0, (0.8, 1.05, 0.3), 60.0, 0.2),
        _solid(ELLIPSOID, (0.07, top - 0.07, 2.55), (0.075, 0.07, 0.075), "peel", 3.0, (1.2, 0.3, 0.25), 10.0, 0.2),
        _solid(BOX, (0.33, top - 0.12, 2.74), (0.11, 0.12, 0.11), "tiles", 1.6, (1.0, 1.05, 1.1), 33.0),
    ]


def _lamp() -> list[Primitive]:
    return [
        _solid(CYLINDER, (0.95, -0.02, 2.7), (0.16, 0.02, 0.16), "marble", 1.0, (0.5, 0.5, 0.55)),
        _solid(CYLINDER, (0.95, -0.78, 2.7), (0.015, 0.76, 0.015), "plaster", 1.0, (0.45, 0.42, 0.4)),
        _solid(CYLINDER, (0.95, -1.62, 2.7), (0.18, 0.14, 0.18), "shade", 1.2, (1.15, 1.0, 0.8)),
    ]


def _plant() -> list[Primitive]:
    parts = [_solid(CYLINDER, (-1.12, -0.24, 2.75), (0.19, 0.24, 0.19), "stone", 1.2, (1.2, 0.75, 0.55))]
    for i in range(13):
        lean, turn = 0.3 + 0.22 * (i % 3), 2.4 * i
        leaf = euler(0.0, turn, 0.0) @ euler(-lean, 0.0, 0.0)
        stem = leaf @ np.array([0.0, -0.34, 0.0])
        tint = (1.2 + 0.1 * (i % 4), 1.4, 0.9)
        parts.append(
            _solid(
                ELLIPSOID,
                stem + np.array([-1.12, -0.46, 2.75]),
                (0.065, 0.33, 0.02),
                "foliage",
                1.4,
                tint,
                rotation=leaf,
            )
        )
    return parts


def still_life() -> World:
    """The floor lies at y = 0 (y points down), the back wall at z = 3.6; the cameras stand near (0, -1.3, 0).

    A room's faces are seen from inside: the textures are those of its right, floor, back, left, ceiling and front.
    """
    faces = ("plaster", "floor", "stone", "tiles", "plaster", "plaster")
    furniture = [
        _solid(ROOM, (0.0, -1.3, 1.2), (1.8, 1.3, 2.4), faces, 0.45, WARM),
        _solid(BOX, (0.0, -0.001, 2.0), (1.8, 0.001, 1.6), "floor", 1.3, WARM),
        _solid(BOX, (-0.1, -0.008, 2.4), (1.0, 0.008, 0.75), "rug", 0.8, (0.95, 1.0, 0.9), 4.0),
        _solid(BOX, (1.3, -0.3, 3.1), (0.38, 0.3, 0.3), "boards", 1.0, (1.1, 0.9, 0.8), -14.0),
        _solid(ELLIPSOID, (1.28, -0.78, 3.08), (0.18, 0.18, 0.18), "cloth", 1.2, WHITE, 20.0, 0.15),
        _solid(BOX, (-0.62, -1.6, 3.585), (0.42, 0.3, 0.015), "poster", 1.0),
        _solid(BOX, (0.25, -1.55, 3.585), (0.24, 0.32, 0.015), "print", 1.4),
        _solid(BOX, (1.25, -1.5, 3.48), (0.4, 0.02, 0.12), "boards", 1.0, (0.9, 0.7, 0.6)),
        _solid(CYLINDER, (1.4, -1.64, 3.47), (0.07, 0.12, 0.07), "mosaic", 2.0, (0.9, 0.8, 1.0)),
        _solid(BOX, (1.58, -1.62, 3.47), (0.05, 0.1, 0.08), "cover", 2.5, (1.2, 0.8, 0.7), 10.0),
    ]
    light = Light(
        position=np.array([-0.75, -2.4, 0.9]),
        colour=np.array([1.05, 0.9, 0.68]),
        falloff=0.07,
        ambient=np.array([0.42, 0.44, 0.50]),
        shadows=True,
    )
    return World((*furniture, *_table(), *_on_the_table(), *_lamp(), *_plant()), light, Background.plain(0.0))
