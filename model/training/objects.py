"""The objects of a scene, built of a few solids each, and the choice of their textures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .primitives import BOX, CYLINDER, ELLIPSOID, Primitive
from .textures import Split, TextureAtlas

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Rng = np.random.Generator


@dataclass(frozen=True)
class Part:
    """One solid of an object that stands on the origin; y points down, so that the object extends to negative y."""

    kind: int
    centre: tuple[float, float, float]
    half: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Paint:
    """Draws textures of one split of the atlas."""

    rng: Rng
    usable: I64
    flat: I64

    @classmethod
    def of(cls, rng: Rng, atlas: TextureAtlas, split: Split) -> Paint:
        usable = atlas.indices(split)
        return cls(rng, usable, usable[atlas.flat[usable]])

    def faces(self, flat_share: float, same_share: float = 0.4) -> I64:
        """(6,) texture indices: each is one of the flat ones with probability `flat_share`; with `same_share` all
        are equal."""
        faces = self.rng.choice(self.usable, 6)
        faces = np.where(self.rng.random(6) < flat_share, self.rng.choice(self.flat, 6), faces)
        return np.full(6, faces[0]) if self.rng.random() < same_share else faces

    def texture_map(self, low: float, high: float) -> F64:
        """(3,) random offset and log-uniform repeats per unit of length."""
        return np.array([*(3 * self.rng.random(2)), np.exp(self.rng.uniform(np.log(low), np.log(high)))])

    def albedo(self) -> F64:
        return self.rng.uniform(0.55, 1.1) * self.rng.uniform(0.85, 1.1, 3)

    def gloss(self) -> float:
        return self.rng.uniform(0.05, 0.35) if self.rng.random() < 0.2 else 0.0


def place(parts: Sequence[Part], paint: Paint, foot: F64, rotation: F64, untextured: float = 0.12) -> list[Primitive]:
    """The solids of an object that stands on `foot`. Most of them share their textures, the others draw their own; with
    probability `untextured` all of these are flat."""
    size = max(max(part.half) for part in parts)
    flat_share = 1.0 if paint.rng.random() < untextured else 0.12
    alike = paint.faces(flat_share, 0.6)
    gloss, albedo = paint.gloss(), paint.albedo()
    return [
        Primitive(
            part.kind,
            foot + rotation @ np.array(part.centre),
            rotation,
            np.array(part.half),
            alike if paint.rng.random() < 0.7 else paint.faces(flat_share, 0.6),
            paint.texture_map(0.06 / size, 0.35 / size),
            albedo,
            gloss,
        )
        for part in parts
    ]


def _box(rng: Rng, size: float) -> list[Part]:
    half = tuple(size * rng.uniform(0.4, 1.3, 3))
    return [Part(BOX, (0, -half[1], 0), half)]


def _ball(rng: Rng, size: float) -> list[Part]:
    half = tuple(size * rng.uniform(0.5, 1.2, 3))
    return [Part(ELLIPSOID, (0, -half[1], 0), half)]


def _drum(rng: Rng, size: float) -> list[Part]:
    radius, half = size * rng.uniform(0.3, 1.0), size * rng.uniform(0.4, 1.3)
    return [Part(CYLINDER, (0, -half, 0), (radius, half, radius))]


def _panel(rng: Rng, size: float) -> list[Part]:
    half = size * np.array([rng.uniform(0.6, 1.6), rng.uniform(0.6, 1.6), rng.uniform(0.01, 0.06)])
    return [Part(BOX, (0, -half[1], 0), tuple(half))]


def _pole(rng: Rng, size: float) -> list[Part]:
    radius, half = size * rng.uniform(0.04, 0.15), size * rng.uniform(1.0, 3.0)
    parts = [Part(CYLINDER if rng.random() < 0.7 else BOX, (0, -half, 0), (radius, half, radius))]
    if rng.random() < 0.4:
        top = size * rng.uniform(0.2, 0.5)
        parts.append(Part(ELLIPSOID, (0, -2 * half, 0), (top, top * rng.uniform(0.5, 1.2), top)))
    return parts


def _table(rng: Rng, size: float) -> list[Part]:
    wide, deep, tall = size * rng.uniform(0.8, 1.6), size * rng.uniform(0.6, 1.2), size * rng.uniform(0.4, 0.8)
    thin, leg = 0.06 * size, 0.06 * size
    parts = [Part(BOX, (0, -2 * tall - thin, 0), (wide, thin, deep))]
    for x in (-1, 1):
        for z in (-1, 1):
            parts.append(Part(CYLINDER, (x * (wide - leg), -tall, z * (deep - leg)), (leg, tall, leg)))
    return parts


def _stack(rng: Rng, size: float) -> list[Part]:
    parts, top = [], 0.0
    for _ in range(rng.integers(2, 5)):
        half = size * np.array([rng.uniform(0.3, 0.9), rng.uniform(0.1, 0.4), rng.uniform(0.3, 0.9)])
        shift = size * rng.uniform(-0.15, 0.15, 2)
        parts.append(Part(int(rng.choice([BOX, CYLINDER])), (shift[0], top - half[1], shift[1]), tuple(half)))
        top -= 2 * half[1]
    if rng.random() < 0.5:
        radius = size * rng.uniform(0.2, 0.4)
        parts.append(Part(ELLIPSOID, (0, top - radius, 0), (radius, radius, radius)))
    return parts


def _fence(rng: Rng, size: float) -> list[Part]:
    count, gap, tall, thin = rng.integers(3, 7), size * rng.uniform(0.3, 0.8), size * rng.uniform(0.5, 1.2), 0.05 * size
    xs = (np.arange(count) - (count - 1) / 2) * gap
    parts = [Part(BOX, (x, -tall, 0), (thin, tall, thin)) for x in xs]
    parts.append(Part(BOX, (0, -1.6 * tall, 0), (float(-xs[0]) + thin, thin, 0.6 * thin)))
    return parts


OBJECTS: tuple[tuple[Callable[[Rng, float], list[Part]], float], ...] = (
    (_box, 0.28), (_ball, 0.22), (_drum, 0.12), (_panel, 0.1), (_pole, 0.1), (_table, 0.05), (_stack, 0.08),
    (_fence, 0.05),
)  # fmt: skip


def random_object(rng: Rng, size: float) -> list[Part]:
    """An object whose half size is about `size`."""
    functions, weights = zip(*OBJECTS, strict=True)
    return functions[rng.choice(len(functions), p=np.array(weights) / sum(weights))](rng, size)
