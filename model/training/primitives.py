"""The solids, light and background that a scene is made of, and their packing into the arrays of the ray caster."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

ROOM, BOX, ELLIPSOID, CYLINDER = 0, 1, 2, 3  # a room is a box seen from inside; a cylinder stands along its own y axis


@dataclass(frozen=True, eq=False)
class Primitive:
    """One textured solid; `rotation` has its own axes as columns."""

    kind: int
    centre: F64  # (3,)
    rotation: F64  # (3, 3) world from own axes
    half: F64  # (3,) half sizes along the own axes, > 0
    textures: I64  # (6,) per face: -x -y -z +x +y +z; ellipsoids use the first, cylinders the first (side) and second
    texture_map: F64  # (3,) offset u, v and repeats per unit of length
    albedo: F64  # (3,) factor on the texture
    gloss: float = 0.0  # strength of the highlight

    def contains(self, points: F64, margin: float) -> NDArray[np.bool_]:
        """Which of the points (N, 3) lie inside, or within `margin` of it; for a room: inside by at least that."""
        local = np.abs((points - self.centre) @ self.rotation)
        if self.kind == ROOM:
            return np.all(local < self.half - margin, axis=1)
        return np.all(local < self.half + margin, axis=1)


@dataclass(frozen=True, eq=False)
class Light:
    """A point light and an ambient one."""

    position: F64  # (3,)
    colour: F64  # (3,) at distance 0
    falloff: float  # intensity = 1 / (1 + falloff distance^2)
    ambient: F64  # (3,)
    shadows: bool = False


@dataclass(frozen=True, eq=False)
class Background:
    """Colour of rays that hit nothing: a gradient from `low`, opposite to `up`, to `high`, in its direction."""

    low: F64  # (3,)
    high: F64  # (3,)
    up: F64 = field(default_factory=lambda: np.array([0.0, -1.0, 0.0]))  # (3,) unit

    @classmethod
    def plain(cls, grey: float) -> Background:
        return cls(np.full(3, grey), np.full(3, grey))


@dataclass(frozen=True, eq=False)
class World:
    """One scene in the canonical frame."""

    primitives: tuple[Primitive, ...]
    light: Light
    background: Background

    def with_more(self, primitives: Sequence[Primitive]) -> World:
        """The same with further things in it."""
        return World((*self.primitives, *primitives), self.light, self.background)


@dataclass(frozen=True, eq=False)
class PackedWorlds:
    """B worlds as arrays; unused slots of `kinds` are beyond `counts`."""

    counts: I64  # (B,)
    kinds: I64  # (B, P)
    centres: F64  # (B, P, 3)
    rotations: F64  # (B, P, 3, 3)
    halves: F64  # (B, P, 3)
    textures: I64  # (B, P, 6)
    texture_maps: F64  # (B, P, 3)
    albedos: F64  # (B, P, 3)
    glosses: F64  # (B, P)
    lights: F64  # (B, 11): position, colour, falloff, ambient, shadows
    backgrounds: F64  # (B, 9): low, high, up

    def arrays(self) -> tuple[I64, I64, F64, F64, F64, I64, F64, F64, F64, F64, F64]:
        """In the order of the ray caster's arguments."""
        return (
            self.counts, self.kinds, self.centres, self.rotations, self.halves, self.textures, self.texture_maps,
            self.albedos, self.glosses, self.lights, self.backgrounds,
        )  # fmt: skip


def pack(worlds: Sequence[World]) -> PackedWorlds:
    """The arrays of several worlds, padded to the largest number of primitives."""
    batch, most = len(worlds), max(1, *(len(world.primitives) for world in worlds))
    packed = PackedWorlds(
        counts=np.array([len(world.primitives) for world in worlds], np.int64),
        kinds=np.zeros((batch, most), np.int64),
        centres=np.zeros((batch, most, 3)),
        rotations=np.zeros((batch, most, 3, 3)),
        halves=np.ones((batch, most, 3)),
        textures=np.zeros((batch, most, 6), np.int64),
        texture_maps=np.zeros((batch, most, 3)),
        albedos=np.zeros((batch, most, 3)),
        glosses=np.zeros((batch, most)),
        lights=np.zeros((batch, 11)),
        backgrounds=np.zeros((batch, 9)),
    )
    for b, world in enumerate(worlds):
        for p, item in enumerate(world.primitives):
            packed.kinds[b, p] = item.kind
            packed.centres[b, p] = item.centre
            packed.rotations[b, p] = item.rotation
            packed.halves[b, p] = item.half
            packed.textures[b, p] = item.textures
            packed.texture_maps[b, p] = item.texture_map
            packed.albedos[b, p] = item.albedo
            packed.glosses[b, p] = item.gloss
        light, background = world.light, world.background
        packed.lights[b] = [*light.position, *light.colour, light.falloff, *light.ambient, float(light.shadows)]
        packed.backgrounds[b] = [*background.low, *background.high, *background.up]
    return packed
