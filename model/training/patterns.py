"""Procedural colour patterns: each draws one (SIZE, SIZE, 3) texture, nearly in [0, 1], from a random generator."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

SIZE = 256

Image = NDArray[np.floating]  # some patterns compute in float32, some in float64
Rng = np.random.Generator

_ROWS, _COLUMNS = (axis.astype(np.float32) / SIZE for axis in np.mgrid[0:SIZE, 0:SIZE])


def fractal(rng: Rng, exponent: float) -> Image:
    """(SIZE, SIZE) periodic noise with power spectrum 1 / f^(2 exponent), mean 0, standard deviation 1."""
    frequency = np.fft.fftfreq(SIZE)[:, None] ** 2 + np.fft.rfftfreq(SIZE)[None] ** 2
    frequency[0, 0] = 1.0
    amplitude = frequency ** (-exponent / 2)
    amplitude[0, 0] = 0.0
    noise = np.fft.irfft2(amplitude * np.exp(2j * np.pi * rng.random(frequency.shape)), s=(SIZE, SIZE))
    return ((noise - noise.mean()) / noise.std()).astype(np.float32)


def _palette(rng: Rng, count: int) -> Image:
    """(count, 3) colours that go together: a base hue, muted or vivid, with varied lightness."""
    grey = rng.uniform(0.1, 0.9, (count, 1))
    tint = rng.random((1, 3)) - 0.5 + 0.6 * (rng.random((count, 3)) - 0.5)
    return np.clip(grey + rng.choice([0.15, 0.5, 0.9]) * tint, 0, 1).astype(np.float32)


def _mix(value: Image, low: Image, high: Image) -> Image:
    return low + (high - low) * value[..., None]


def clouds(rng: Rng) -> Image:
    noise = fractal(rng, rng.uniform(1.0, 2.6))
    colours = _palette(rng, 3)
    image = _mix(1 / (1 + np.exp(-noise * rng.uniform(0.7, 3.0))), colours[0], colours[1])
    return _mix(1 / (1 + np.exp(-2.0 * fractal(rng, 2.0))), image, colours[2]) if rng.random() < 0.5 else image


def checker(rng: Rng) -> Image:
    count = rng.integers(2, 12)
    return _mix((np.floor(_COLUMNS * count) + np.floor(_ROWS * count)) % 2, *_palette(rng, 2))


def stripes(rng: Rng) -> Image:
    count, angle = rng.integers(2, 14), rng.uniform(0, np.pi)
    wave = np.sin(2 * np.pi * count * (_COLUMNS * np.cos(angle) + _ROWS * np.sin(angle)))
    value = (wave > rng.uniform(-0.7, 0.7)).astype(np.float32) if rng.random() < 0.7 else 0.5 + 0.5 * wave
    return _mix(value, *_palette(rng, 2))


def dots(rng: Rng) -> Image:
    count = rng.integers(3, 10)
    rows, columns = _ROWS * count, _COLUMNS * count
    columns = columns + 0.5 * (np.floor(rows) % 2) * rng.integers(2)
    inside = (rows % 1 - 0.5) ** 2 + (columns % 1 - 0.5) ** 2 < rng.uniform(0.04, 0.2)
    colours = _palette(rng, 9)
    cell = (np.floor(rows) * 3 + np.floor(columns)).astype(int) % rng.integers(1, 9)
    return np.where(inside[..., None], colours[1 + cell], colours[0])


def bricks(rng: Rng) -> Image:
    count, aspect = rng.integers(2, 9), rng.choice([1, 2, 3])
    rows = _ROWS * count * aspect
    columns = _COLUMNS * count + rng.choice([0.0, 0.5]) * (np.floor(rows) % 2)
    tile = rng.random((64, 64)).astype(np.float32)[np.floor(rows).astype(int) % 64, np.floor(columns).astype(int) % 64]
    colours = _palette(rng, 3)
    joint = (columns % 1 < rng.uniform(0.02, 0.08)) | (rows % 1 < rng.uniform(0.03, 0.15))
    return np.where(joint[..., None], colours[2], _mix(tile, colours[0], colours[1]))


def voronoi(rng: Rng) -> Image:
    count = int(rng.integers(6, 60))
    points = rng.random((count, 2)).astype(np.float32)
    nearest = np.full((SIZE, SIZE), np.inf, np.float32)
    cell = np.zeros((SIZE, SIZE), np.int64)
    for i, (row, column) in enumerate(points):
        distance = ((_ROWS - row + 0.5) % 1 - 0.5) ** 2 + ((_COLUMNS - column + 0.5) % 1 - 0.5) ** 2
        cell = np.where(distance < nearest, i, cell)
        nearest = np.minimum(distance, nearest)
    image = _palette(rng, count)[cell]
    return image * (1 - rng.uniform(0, 0.5) * np.sqrt(nearest * float(count))[..., None].clip(0, 1))


def wood(rng: Rng) -> Image:
    """Rings around an axis outside the board, bent by noise."""
    centre, stretch = rng.uniform(-1.5, -0.3), rng.uniform(0.05, 0.3)
    radius = np.hypot(_COLUMNS - centre, stretch * (_ROWS - 0.5)) + 0.02 * fractal(rng, 1.8)
    rings = (radius * rng.uniform(8, 30)) % 1
    dark = np.clip(rng.uniform(0.15, 0.5) * np.array([1.0, 0.65, 0.4]) + rng.normal(0, 0.04, 3), 0, 1)
    light = np.clip(dark * rng.uniform(1.3, 2.2), 0, 1)
    return _mix(rings**2, light.astype(np.float32), dark.astype(np.float32))


def wall(rng: Rng) -> Image:
    """Nearly uniform paint or plaster, on which stereo matching finds nothing."""
    colour = _palette(rng, 1)[0]
    return colour * (1 + rng.uniform(0.0, 0.06) * fractal(rng, rng.uniform(0.6, 2.0)))[..., None]


def gradient(rng: Rng) -> Image:
    angle = rng.uniform(0, 2 * np.pi)
    return _mix(0.5 + 0.5 * ((_COLUMNS - 0.5) * np.cos(angle) + (_ROWS - 0.5) * np.sin(angle)), *_palette(rng, 2))


def strokes(rng: Rng) -> Image:
    """Lines of word-like runs of short upright and slanted marks, as on a page or a poster."""
    colours = _palette(rng, 4)
    image = np.broadcast_to(colours[0], (SIZE, SIZE, 3)).copy()
    height = int(rng.integers(6, 22))
    for row in range(height // 2, SIZE - height, int(height * rng.uniform(1.3, 2.2))):
        column = int(rng.integers(2, 30))
        ink = colours[rng.integers(1, 4)]
        while column < SIZE - 10:
            for _ in range(rng.integers(2, 9)):
                width = int(rng.integers(1, max(2, height // 3)))
                top = row + int(rng.integers(0, height // 2))
                slant = rng.integers(-1, 2)
                for step in range(row + height - top):
                    start = column + slant * step // 4
                    image[top + step, max(start, 0) : max(start + width, 0)] = ink
                if rng.random() < 0.5:
                    image[top : top + max(1, height // 6), column : column + height // 2] = ink
                column += int(height * rng.uniform(0.4, 0.8))
            column += height
    return image


def leaves(rng: Rng) -> Image:
    """The dead leaves model: overlapping opaque discs and bars of all sizes, with occlusions as in photographs."""
    colours = _palette(rng, 24) if rng.random() < 0.7 else rng.random((24, 3)).astype(np.float32)
    image = np.broadcast_to(colours[0], (SIZE, SIZE, 3)).copy()
    smallest = rng.uniform(2.0, 6.0)
    for _ in range(rng.integers(150, 400)):
        radius = min(smallest / rng.uniform(0.03, 1.0) ** 0.8, 70.0)
        reach = int(radius) + 1
        row, column = rng.integers(-reach // 2, SIZE, 2)
        top, left = max(row, 0), max(column, 0)
        patch = image[top : row + 2 * reach, left : column + 2 * reach]
        if patch.size == 0:
            continue
        dy = np.arange(top, top + patch.shape[0])[:, None] - (row + radius)
        dx = np.arange(left, left + patch.shape[1])[None] - (column + radius)
        angle, narrow = rng.uniform(0, np.pi), rng.uniform(1.0, 4.0)
        along, across = dx * np.cos(angle) + dy * np.sin(angle), dy * np.cos(angle) - dx * np.sin(angle)
        inside = along**2 + (narrow * across) ** 2 < radius**2
        shade = 1 + rng.uniform(-0.3, 0.3) * (along / radius)[..., None]
        patch[:] = np.where(inside[..., None], colours[rng.integers(24)] * shade, patch)
    return image


PATTERNS: tuple[tuple[Callable[[Rng], Image], float], ...] = (
    (clouds, 0.15), (leaves, 0.2), (checker, 0.05), (stripes, 0.06), (dots, 0.06), (bricks, 0.09),
    (voronoi, 0.08), (wood, 0.07), (wall, 0.12), (gradient, 0.04), (strokes, 0.08),
)  # fmt: skip
FLAT = (wall, gradient)


def draw(rng: Rng) -> tuple[NDArray[np.float32], bool]:
    """One texture by a random pattern, weathered by noise, and whether it is (nearly) flat."""
    functions, weights = zip(*PATTERNS, strict=True)
    pattern = functions[rng.choice(len(functions), p=np.array(weights) / sum(weights))]
    image = pattern(rng)
    if pattern not in FLAT:
        weather = fractal(rng, rng.uniform(0.8, 2.4))[..., None]
        image = image + rng.uniform(0.0, 0.12) * weather * (0.5 + rng.random(3, np.float32))
    image = np.clip(image, 0, 1) ** np.float32(np.exp(rng.uniform(-0.4, 0.4)))
    return image.astype(np.float32), pattern in FLAT
