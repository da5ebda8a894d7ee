"""Layers of the network in numpy and float64, written from their definitions and not from the project's code."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def relu(x: Array) -> Array:
    return np.maximum(x, 0)


def gelu(x: Array) -> Array:
    return x / 2 * (1 + np.vectorize(math.erf, otypes=[np.float64])(x / math.sqrt(2)))


def sigmoid(x: Array) -> Array:
    return 1 / (1 + np.exp(-x))


def softplus(x: Array) -> Array:
    return np.logaddexp(0, x)


def softmax(x: Array, axis: int) -> Array:
    powers = np.exp(x - x.max(axis, keepdims=True))
    return powers / powers.sum(axis, keepdims=True)


def unit(x: Array) -> Array:
    """Normalised to length 1 over the channels."""
    return x / np.sqrt((x * x).sum(1, keepdims=True))


def pooled(x: Array, size: int = 2) -> Array:
    """Means over size x size pixels."""
    n, c, h, w = x.shape
    return x.reshape(n, c, h // size, size, w // size, size).mean((3, 5))


def shuffled(x: Array, size: int = 2) -> Array:
    """Channels become size x size pixels, row by row."""
    n, c, h, w = x.shape
    x = x.reshape(n, c // size**2, size, size, h, w).transpose(0, 1, 4, 2, 5, 3)
    return x.reshape(n, c // size**2, h * size, w * size)


def unshuffled(x: Array, size: int = 2) -> Array:
    n, c, h, w = x.shape
    x = x.reshape(n, c, h // size, size, w // size, size).transpose(0, 1, 3, 5, 2, 4)
    return x.reshape(n, c * size**2, h // size, w // size)


def margin(x: Array, size: int) -> Array:
    """The border pixels are repeated outwards."""
    return np.pad(x, [(0, 0)] * (x.ndim - 2) + [(size, size)] * 2, mode="edge")


def resized(x: Array, height: int, width: int, *, cubic: bool = False) -> Array:
    """(n, c, h, w) -> (n, c, height, width), positions at pixel centres; bilinear, or cubic with a = -0.75."""
    rows, columns = (_resizing(a, b, cubic) for a, b in zip(x.shape[2:], (height, width), strict=True))
    return rows @ x @ columns.T


def _resizing(old: int, new: int, cubic: bool) -> Array:
    matrix = np.zeros((new, old))
    for row in range(new):
        at = (row + 0.5) * old / new - 0.5
        first = math.floor(at) - cubic
        for column in range(first, first + (4 if cubic else 2)):
            matrix[row, min(max(column, 0), old - 1)] += _kernel(abs(at - column), cubic)
    return matrix


def _kernel(x: float, cubic: bool, a: float = -0.75) -> float:
    if not cubic:
        return 1 - x
    if x <= 1:
        return (a + 2) * x**3 - (a + 3) * x**2 + 1
    return a * (x**3 - 5 * x**2 + 8 * x - 4)


def box(x: Array, radius: int) -> Array:
    """Sums of pictures (..., h, w) over windows of 2 * radius + 1 px, limited to the picture."""
    h, w = x.shape[-2:]
    rows = np.stack([x[..., max(0, y - radius) : y + radius + 1, :].sum(-2) for y in range(h)], axis=-2)
    return np.stack([rows[..., max(0, c - radius) : c + radius + 1].sum(-1) for c in range(w)], axis=-1)


def mean_inside(x: Array, radius: int) -> Array:
    return box(x, radius) / box(np.ones_like(x), radius)


def mean_repeated(x: Array, radius: int) -> Array:
    """Means over windows of a picture whose border is repeated outwards."""
    return box(margin(x, radius), radius)[..., radius:-radius, radius:-radius] / (2 * radius + 1) ** 2


def sampled(x: Array, px: Array, py: Array, *, repeat: bool) -> Array:
    """(c, ...) bilinear samples of (c, h, w), where pixel i lies at i; beyond the border it is repeated, or 0."""
    h, w = x.shape[-2:]
    if repeat:
        px, py = px.clip(0, w - 1), py.clip(0, h - 1)
    left, top = np.floor(px).astype(int), np.floor(py).astype(int)
    total = np.zeros((x.shape[0], *px.shape))
    for right in (0, 1):
        for down in (0, 1):
            column, row = left + right, top + down
            inside = (column >= 0) & (column < w) & (row >= 0) & (row < h)
            weight = (1 - np.abs(px - column)) * (1 - np.abs(py - row)) * inside
            total += x[:, row.clip(0, h - 1), column.clip(0, w - 1)] * weight
    return total


@dataclass(frozen=True)
class Weights:
    """The weights of a checkpoint by name, and the layers that use them."""

    values: Mapping[str, Array]

    def __getitem__(self, name: str) -> Array:
        return self.values[name]

    def convolved(self, x: Array, name: str, stride: int = 1, *, groups: int = 1) -> Array:
        """Padded with zeros so that stride 1 keeps the size."""
        weight, bias = self[f"{name}.weight"], self[f"{name}.bias"]
        size = weight.shape[-1]
        x = np.pad(x, [(0, 0), (0, 0), (size // 2, size // 2), (size // 2, size // 2)])
        return self._products(x, weight, stride, groups) + bias[:, None, None]

    @staticmethod
    def _products(x: Array, weight: Array, stride: int, groups: int) -> Array:
        size = weight.shape[-1]
        h, w = ((length - size) // stride + 1 for length in x.shape[2:])
        total: Array = np.zeros((x.shape[0], weight.shape[0], h, w))
        for row in range(size):
            for column in range(size):
                part = x[:, :, row : row + stride * h : stride, column : column + stride * w : stride][:, :, :h, :w]
                tap = weight[:, :, row, column]
                each = np.tensordot(part, tap, (1, 1)).transpose(0, 3, 1, 2) if groups == 1 else part * tap[..., None]
                total += each
        return total

    def linear(self, x: Array, name: str) -> Array:
        return x @ self[f"{name}.weight"].T + self[f"{name}.bias"]

    def layer_norm(self, x: Array, name: str, epsilon: float) -> Array:
        centred = x - x.mean(-1, keepdims=True)
        scaled = centred / np.sqrt((centred**2).mean(-1, keepdims=True) + epsilon)
        return scaled * self[f"{name}.weight"] + self[f"{name}.bias"]

    def group_norm(self, x: Array, name: str, groups: int = 8, epsilon: float = 1e-5) -> Array:
        grouped = x.reshape(x.shape[0], groups, -1)
        centred = grouped - grouped.mean(-1, keepdims=True)
        scaled = (centred / np.sqrt((centred**2).mean(-1, keepdims=True) + epsilon)).reshape(x.shape)
        return scaled * self[f"{name}.weight"][:, None, None] + self[f"{name}.bias"][:, None, None]

    def block(self, x: Array, name: str) -> Array:
        """A residual block."""
        inner = self.convolved(relu(self.group_norm(x, f"{name}.norm")), f"{name}.first")
        return x + self.convolved(relu(inner), f"{name}.second")


def attended(query: Array, key: Array, value: Array, heads: int) -> Array:
    """(n, tokens, c) attention of queries (n, tokens, c) to keys and values (n, others, c)."""
    q, k, v = (x.reshape(*x.shape[:2], heads, -1).transpose(0, 2, 1, 3) for x in (query, key, value))
    shares = softmax(q @ k.transpose(0, 1, 3, 2) / math.sqrt(q.shape[-1]), -1)
    return (shares @ v).transpose(0, 2, 1, 3).reshape(query.shape)
