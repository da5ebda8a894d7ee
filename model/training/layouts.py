"""Random worlds in the canonical frame: the middle camera near the origin looks along +z, y is down, depth about 1."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from .objects import Paint, Part, place, random_object
from .primitives import BOX, ROOM, Background, Light, Primitive, World
from .rotations import tilt

F64 = NDArray[np.float64]
Rng = np.random.Generator

MOST_PRIMITIVES = 26  # the cost of a ray is about proportional to it


def make_world(rng: Rng, paint: Paint, half_width: float) -> World:
    """A room, an outdoor place, objects before a wall, or objects alone; `half_width` = tan(horizontal fov / 2)."""
    layouts: tuple[Callable[[Rng, Paint, float], World], ...] = (_room, _outdoor, _before_wall, _objects_alone)
    return layouts[rng.choice(4, p=(0.45, 0.25, 0.15, 0.15))](rng, paint, half_width)


def _room(rng: Rng, paint: Paint, half_width: float) -> World:
    scale = max(half_width, 0.5)
    back = rng.uniform(1.1, 2.4)
    frame = tilt(rng, 0.12, 0.3, 0.05)
    half = np.array([rng.uniform(0.9, 2.2) * scale, rng.uniform(0.6, 1.4) * scale, (back + 1.0) / 2])
    centre = frame @ np.array([rng.uniform(-0.4, 0.4) * half[0], rng.uniform(-0.4, 0.4) * half[1], back - half[2]])
    shell = Primitive(ROOM, centre, frame, half, paint.faces(0.35), paint.texture_map(0.4, 1.8), paint.albedo())
    solids = [shell]
    if rng.random() < 0.6:  # pictures and a shelf on the back wall
        for _ in range(rng.integers(1, 6)):
            size = np.array([rng.uniform(0.06, 0.25), rng.uniform(0.06, 0.25), rng.uniform(0.005, 0.05)]) * scale
            spot = np.array([*(rng.uniform(-0.8, 0.8, 2) * half[:2]), half[2] - size[2]])
            solids.append(
                Primitive(
                    BOX, centre + frame @ spot, frame, size, paint.faces(0.1),
                    paint.texture_map(0.2 / size[0], 0.7 / size[0]), paint.albedo(),
                )
            )  # fmt: skip
    floor = float((frame.T @ centre)[1] + half[1])
    solids += _scatter(rng, paint, half_width, frame, floor, int(rng.integers(4, 14)))
    inside = centre + frame @ (rng.uniform((-0.8, -0.95, -0.5), (0.8, 0.2, 0.8)) * half)
    return World(tuple(solids[:MOST_PRIMITIVES]), _light(rng, inside), Background.plain(0.0))


def _outdoor(rng: Rng, paint: Paint, half_width: float) -> World:
    """Ground, perhaps houses or a far wall, and a sky."""
    frame = tilt(rng, 0.08, 0.3, 0.03)
    floor = rng.uniform(0.25, 0.7) * max(half_width, 0.5) + 0.1
    ground = Primitive(
        BOX, frame @ np.array([0.0, floor + 0.05, 1.0]), frame, np.array([12.0, 0.05, 12.0]), paint.faces(0.15),
        paint.texture_map(0.3, 1.6), paint.albedo(),
    )  # fmt: skip
    solids = [ground]
    for _ in range(rng.integers(0, 5)):
        depth = rng.uniform(1.8, 5.0)
        half = np.array([rng.uniform(0.2, 0.9), rng.uniform(0.3, 1.5), rng.uniform(0.2, 0.6)]) * 0.5 * depth
        spot = np.array([rng.uniform(-1.3, 1.3) * depth * half_width, floor - half[1], depth + half[2]])
        solids.append(
            Primitive(BOX, frame @ spot, frame @ tilt(rng, 0, 0.5, 0), half, paint.faces(0.2),
                      paint.texture_map(0.2, 0.8), paint.albedo())
        )  # fmt: skip
    solids += _scatter(rng, paint, half_width, frame, floor, int(rng.integers(4, 12)))
    sky = Background(
        np.clip(rng.uniform(0.55, 1.0) + rng.normal(0, 0.08, 3), 0, 1),
        np.clip(rng.uniform(0.3, 0.9) + np.array([-0.2, 0.0, 0.25]) * rng.uniform(0, 1) + rng.normal(0, 0.05, 3), 0, 1),
        frame @ np.array([0.0, -1.0, 0.0]),
    )
    if rng.random() < 0.15:
        sky = Background.plain(float(rng.choice([0.0, 0.02, 1.0])))
    sun = frame @ np.array([rng.uniform(-6, 6), rng.uniform(-9, -3), rng.uniform(-5, 6)])
    return World(tuple(solids[:MOST_PRIMITIVES]), _light(rng, sun, falloff=0.0), sky)


def _before_wall(rng: Rng, paint: Paint, half_width: float) -> World:
    """A large wall across the view and objects before it, some of them floating."""
    frame = tilt(rng, 0.1, 0.3, 0.2)
    back = rng.uniform(1.1, 2.2)
    wall = Primitive(
        BOX, np.array([0.0, 0.0, back + 0.05]), frame, np.array([8.0, 8.0, 0.05]), paint.faces(0.15),
        paint.texture_map(0.3, 1.5), paint.albedo(),
    )  # fmt: skip
    solids = [wall, *_scatter(rng, paint, half_width, frame, rng.uniform(0.3, 0.6), int(rng.integers(3, 13)))]
    lamp = np.array([rng.uniform(-1, 1), rng.uniform(-1.5, 0.2), rng.uniform(-0.5, 0.6)])
    return World(tuple(solids[:MOST_PRIMITIVES]), _light(rng, lamp), Background.plain(0.0))


def _objects_alone(rng: Rng, paint: Paint, half_width: float) -> World:
    """A group of objects before black, white or grey, mostly on a table top."""
    frame = tilt(rng, 0.05, 0.5, 0.03)
    solids, floor = [], rng.uniform(0.15, 0.4) * half_width
    if rng.random() < 0.65:
        size = rng.uniform(0.5, 1.3) * half_width
        solids.append(
            Primitive(BOX, frame @ np.array([0.0, floor + 0.02, 1.0]), frame, np.array([size, 0.02, size]),
                      paint.faces(0.3), paint.texture_map(0.4, 2.0), paint.albedo())
        )  # fmt: skip
    for _ in range(rng.integers(2, 7)):
        size = rng.uniform(0.15, 0.5) * half_width
        spot = np.array([rng.normal(0, 0.4) * half_width, floor, 1.0 + rng.normal(0, 0.3) * half_width])
        solids += place(random_object(rng, size), paint, frame @ spot, frame @ tilt(rng, 0, 1.5, 0))
    grey = float(rng.choice([0.0, 0.03, 1.0, rng.uniform(0.1, 0.9)], p=(0.35, 0.15, 0.3, 0.2)))
    lamp = np.array([rng.uniform(-2, 2), rng.uniform(-3, -0.5), rng.uniform(-1, 1)])
    return World(tuple(solids[:MOST_PRIMITIVES]), _light(rng, lamp), Background.plain(grey))


def _scatter(rng: Rng, paint: Paint, half_width: float, frame: F64, floor: float, count: int) -> list[Primitive]:
    """Objects in view at depths of 0.42 to about 1.7: most stand on the floor, the others float, turned at random."""
    solids: list[Primitive] = []
    standing = rng.choice([0.9, 0.5, 0.1], p=(0.55, 0.25, 0.2))
    for _ in range(count):
        size = math.exp(rng.uniform(math.log(0.05), math.log(0.3)))
        depth = max(rng.uniform(0.55, 1.7), 0.42 + 1.8 * size)
        side = rng.uniform(-1.1, 1.1) * depth * half_width
        if rng.random() < standing:
            spot, rotation = frame @ np.array([side, floor, depth]), frame @ tilt(rng, 0, 1.0, 0)
        else:
            spot, rotation = np.array([side, rng.uniform(-1, 1) * depth * half_width, depth]), tilt(rng, 1, 1, 1)
        solids += place(random_object(rng, size), paint, spot, rotation)
    return solids


def near_occluder(rng: Rng, paint: Paint, pose: F64, half_width: float, depth: float) -> list[Primitive]:
    """An object close to the camera at `pose` (4, 4), at the edge of its picture: mostly a bar along the whole edge,
    like a door frame. `depth` is the median depth of the scene. The other cameras mostly see past the object."""
    away = depth * math.exp(rng.uniform(math.log(0.2), math.log(0.6)))
    edge = half_width * away
    level = rng.random() < 0.25  # a lintel or a sill
    side = rng.choice([-1.0, 1.0])
    turned = tilt(rng, 0.03, 0.3, 0.03)
    if rng.random() < 0.65:
        wide = edge * rng.uniform(0.2, 1.0)
        across = side * (edge * (1 - 2 * rng.uniform(0.04, 0.35)) + wide)
        spot, half = np.array([across, 0.0, away]), np.array([wide, 2 * edge, rng.uniform(0.01, 0.2) * away])
        if level:
            spot, half = spot[[1, 0, 2]], half[[1, 0, 2]]
        parts = [Part(BOX, (0.0, 0.0, 0.0), (half[0], half[1], half[2]))]
        untextured = 0.5
    else:
        parts, untextured = random_object(rng, edge * rng.uniform(0.2, 0.6)), 0.12
        spot = np.array([side * rng.uniform(0.6, 1.1) * edge, rng.uniform(0.2, 1.2) * edge, away])
    rotation = pose[:3, :3]
    return place(parts, paint, pose[:3, 3] + rotation @ spot, rotation @ turned, untextured)


def _light(rng: Rng, position: F64, falloff: float | None = None) -> Light:
    strength = rng.uniform(0.0, 1.2)
    shadows = strength > 0.3 and rng.random() < 0.45
    ambient = rng.uniform(0.25, 0.6) if shadows else rng.uniform(0.35, 0.9)
    warmth = rng.normal(0, 0.12) * np.array([1.0, 0.1, -1.0])
    return Light(
        position=position,
        colour=strength * np.clip(1 + warmth + rng.normal(0, 0.03, 3), 0.4, 1.6),
        falloff=rng.uniform(0.0, 0.7) if falloff is None else falloff,
        ambient=np.clip(ambient * (1 + rng.normal(0, 0.08, 3)), 0.15, 1.0),
        shadows=shadows,
    )
