"""The network `tiny` in numpy and float64, written from docs/network.md and docs/matching.md."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from float64_layers import (
    Array,
    Weights,
    attended,
    gelu,
    margin,
    pooled,
    relu,
    resized,
    shuffled,
    sigmoid,
    softmax,
    softplus,
    unit,
)
from float64_matching import PLANES, Cameras, depth
from numpy.typing import NDArray

C0 = 0.5 / np.sqrt(np.pi)  # the constant harmonic
HEADS = 4
TEMPERATURE = 0.8
EXPERTS, CHOSEN = 6, 2
PATCH, CELL = 16, 8  # px
MEAN = np.array([0.485, 0.456, 0.406])[:, None, None]
DEVIATION = np.array([0.229, 0.224, 0.225])[:, None, None]


@dataclass(frozen=True)
class Result:
    """The outputs, by the names of the ONNX contract."""

    means: Array
    scales: Array
    rotations_wxyz: Array
    opacities: Array
    harmonics: Array
    depth: Array
    confidence: Array
    expert_index: NDArray[np.int64]
    expert_weight: Array
    task_weight: Array
    route_margin: Array


def transformer(weights: Weights, images: Array, name: str) -> Array:
    """(V, 96, H/16, W/16) tokens of the ViT `name`."""
    x = (images - MEAN) / DEVIATION
    n, _, height, width = x.shape
    rows, columns = height // PATCH, width // PATCH
    kernel = weights[f"{name}.embeddings.patch_embeddings.projection.weight"]
    blocks = x.reshape(n, 3, rows, PATCH, columns, PATCH)
    tokens = np.einsum("ncaybx,ocyx->nabo", blocks, kernel, optimize=True)
    tokens = tokens + weights[f"{name}.embeddings.patch_embeddings.projection.bias"]
    first = np.broadcast_to(weights[f"{name}.embeddings.cls_token"], (n, 1, kernel.shape[0]))
    tokens = np.concatenate([first, tokens.reshape(n, rows * columns, -1)], axis=1)
    tokens = tokens + _places(weights[f"{name}.embeddings.position_embeddings"], rows, columns)
    for number in range(3):
        layer = f"{name}.encoder.layer.{number}"
        y = weights.layer_norm(tokens, f"{layer}.norm1", 1e-6)
        q, k, v = (weights.linear(y, f"{layer}.attention.{kind}_proj") for kind in "qkv")
        y = weights.linear(attended(q, k, v, HEADS), f"{layer}.attention.o_proj")
        tokens = tokens + y * weights[f"{layer}.layer_scale1.lambda1"]
        y = weights.layer_norm(tokens, f"{layer}.norm2", 1e-6)
        y = weights.linear(gelu(weights.linear(y, f"{layer}.mlp.fc1")), f"{layer}.mlp.fc2")
        tokens = tokens + y * weights[f"{layer}.layer_scale2.lambda1"]
    tokens = weights.layer_norm(tokens, f"{name}.layernorm", 1e-6)[:, 1:]
    return tokens.transpose(0, 2, 1).reshape(n, -1, rows, columns)


def _places(stored: Array, rows: int, columns: int) -> Array:
    """Position embeddings (1, 1 + 16 * 16, c), resized to another grid."""
    side = round((stored.shape[1] - 1) ** 0.5)
    grid = stored[:, 1:].reshape(1, side, side, -1).transpose(0, 3, 1, 2)
    grid = resized(grid, rows, columns, cubic=True)
    return np.concatenate([stored[:, :1], grid.transpose(0, 2, 3, 1).reshape(1, rows * columns, -1)], axis=1)


def trunk(weights: Weights, images: Array) -> tuple[Array, Array]:
    """Features at half and at quarter."""
    half = weights.block(relu(weights.convolved(images * 2 - 1, "trunk.to_half", 2)), "trunk.at_half")
    quarter = relu(weights.convolved(half, "trunk.to_quarter", 2))
    quarter = weights.block(weights.block(quarter, "trunk.at_quarter.0"), "trunk.at_quarter.1")
    eighth = relu(weights.convolved(quarter, "trunk.to_eighth", 2))
    for name in ("trunk.cross_view.0", "trunk.cross_view.1"):
        eighth = _attention_block(weights, eighth, name)
    return half, quarter + resized(weights.convolved(eighth, "trunk.from_eighth"), *quarter.shape[2:])


def _attention_block(weights: Weights, x: Array, name: str) -> Array:
    views, channels, h, w = x.shape
    x = x + weights.convolved(x, f"{name}.position", groups=channels)
    tokens = x.reshape(views, channels, -1).transpose(0, 2, 1)

    def fewer(tokens: Array) -> Array:
        grid = pooled(tokens.transpose(0, 2, 1).reshape(views, channels, h, w))
        return grid.reshape(views, channels, -1).transpose(0, 2, 1)

    for kind in ("self", "cross"):
        normed = weights.layer_norm(tokens, f"{name}.norm_{kind}", 1e-5)
        read = fewer(normed)
        if kind == "cross":
            read = np.stack([np.concatenate([read[o] for o in range(views) if o != v]) for v in range(views)])
        key, value = np.split(weights.linear(read, f"{name}.key_value_{kind}"), 2, axis=-1)
        found = attended(weights.linear(normed, f"{name}.query_{kind}"), key, value, HEADS)
        tokens = tokens + weights.linear(found, f"{name}.out_{kind}")
    y = weights.linear(weights.layer_norm(tokens, f"{name}.norm_mlp", 1e-5), f"{name}.mlp.0")
    tokens = tokens + weights.linear(gelu(y), f"{name}.mlp.2")
    return tokens.transpose(0, 2, 1).reshape(views, channels, h, w)


def _in_patches(x: Array) -> Array:
    n, c, h, w = x.shape
    return x.reshape(n, c, h // 4, 4, w // 4, 4).transpose(0, 2, 4, 1, 3, 5).reshape(-1, c, 4, 4)


def _from_patches(x: Array, views: int, h: int, w: int) -> Array:
    c = x.shape[1]
    return x.reshape(views, h // 4, w // 4, c, 4, 4).transpose(0, 3, 1, 4, 2, 5).reshape(views, c, h, w)


def _hybrid(logits: Array, balance: Array) -> Array:
    soft = softmax(logits / TEMPERATURE, 1)
    hard = np.arange(logits.shape[1]) == soft.argmax(1)[:, None]
    share = sigmoid(balance)
    return share * hard + (1 - share) * soft


def mixture(
    weights: Weights, streams: dict[str, Array], keep: NDArray[np.bool_]
) -> tuple[list[Array], dict[str, Array]]:
    """The four tasks' maps, and the routing of all patches."""
    views, _, h, w = streams["texture"].shape
    aligned = [weights.convolved(streams[name], f"mixture.align.{name}") for name in ("depth", "texture", "semantic")]
    query = _in_patches(np.concatenate([resized(each, h, w) for each in aligned], axis=1))
    flat = query.reshape(len(query), -1)
    expert_logits = weights.linear(flat, "mixture.gates.expert_gate")
    task_logits = weights.linear(flat, "mixture.gates.task_gate")
    index = np.argsort(-expert_logits, axis=1, kind="stable")[:, :CHOSEN]
    expert = _hybrid(np.take_along_axis(expert_logits, index, 1), weights["mixture.gates.expert_balance"])
    task = _hybrid(task_logits, weights["mixture.gates.task_balance"])
    gaps = []
    for logits, deciding in ((expert_logits, CHOSEN), (task_logits, 1)):
        ordered = -np.sort(-logits, axis=1)
        gap = (ordered[:, :-1] - ordered[:, 1:])[:, :deciding].min(1)
        gaps.append(gap / np.abs(logits).max(1))
    expert, task = expert * keep[:, None], task * keep[:, None]
    theta = query.copy()
    for number in range(EXPERTS):
        name = f"mixture.experts.experts.{number}.layers"
        x = query.reshape(-1, 32, 4, 4)  # each stream by itself
        for layer in ("0", "2"):
            x = gelu(weights.convolved(x, f"{name}.{layer}"))
        share = (expert * (index == number)).sum(1)
        theta += share[:, None, None, None] * weights.convolved(x, f"{name}.4").reshape(query.shape)
    maps = [_from_patches(theta * (1 + task[:, k, None, None, None]), views, h, w) for k in range(4)]
    return maps, {
        "expert_index": index, "expert_weight": expert, "task_weight": task, "route_margin": np.minimum(*gaps),
    }  # fmt: skip


def _head(weights: Weights, name: str, features: Array, guide: Array) -> Array:
    half = shuffled(weights.convolved(features, f"heads.{name}.project"))
    joined = relu(weights.convolved(np.concatenate([half, guide], axis=1), f"heads.{name}.join"))
    return shuffled(weights.convolved(joined, f"heads.{name}.out"))


def _product(a: Array, b: Array) -> Array:
    """The product of a quaternion (4,) and others (..., 4), wxyz."""
    w, x, y, z = a
    matrix = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return b @ matrix.T


def _quaternion(rotation: Array) -> Array:
    """The quaternion of a rotation of less than 180 degrees, w > 0."""
    w = np.sqrt(1 + np.trace(rotation)) / 2
    axis = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    return np.array([w, *axis / (4 * w)])


def _last(x: Array) -> Array:
    """(c, h, w) -> (h * w, c)"""
    return x.reshape(x.shape[0], -1).T


def network(weights: Weights, images: Array, cameras: Cameras, patch_mask: NDArray[np.bool_]) -> Result:
    """The outputs for images (V, 3, H, W) in [0, 1] and patch_mask (V, P)."""
    views, _, height, width = images.shape
    half, quarter = trunk(weights, images)
    size = quarter.shape[2:]
    semantic = transformer(weights, images, "semantic.vit")
    mono = resized(weights.convolved(transformer(weights, images, "mono.vit"), "mono_context"), *size)
    found = depth(weights, images, half, quarter, mono, cameras)
    streams = {
        "depth": np.concatenate([mono, found.volume, found.coarse, found.confidence], axis=1),
        "texture": quarter,
        "semantic": semantic,
    }
    maps, routing = mixture(weights, streams, patch_mask.reshape(-1))
    mu = np.tanh(_head(weights, "mu", maps[0], found.guide))
    opacity = sigmoid(2 * _head(weights, "alpha", maps[1], found.guide) + 1.5)
    covariance = _head(weights, "epsilon", maps[2], found.guide)
    scale = 0.25 + 0.7 * softplus((3 * covariance[:, :3] - 1.5).clip(None, 20))
    turn = unit(covariance[:, 3:] + np.array([1.0, 0, 0, 0])[:, None, None])
    colour = (images + np.tanh(_head(weights, "colour", maps[3], found.guide)) / 2).clip(-0.1, 1.1)
    kept = patch_mask.reshape(views, 1, height // PATCH, width // PATCH).repeat(PATCH, 2).repeat(PATCH, 3)
    u = (found.full + mu[:, 2:] / (PLANES - 1)).clip(-0.01, 1.3)
    z = 1 / cameras.inverse(u.clip(0))

    y, x = np.meshgrid(np.arange(height) + 0.5, np.arange(width) + 0.5, indexing="ij")
    parts: list[list[Array]] = []
    for view in range(views):
        shares = (x + mu[view, 0]) / width, (y + mu[view, 1]) / height
        parts.append(_placed(cameras, view, images, shares, z[view, 0], scale[view], turn[view]))
        parts[-1] += [(opacity[view] * kept[view]).reshape(-1), _last(colour[view])]
    parts += [_backing(cameras, view, images, u[view, 0], kept[view, 0]) for view in range(views)]
    means, scales, rotations, opacities, colours = (np.concatenate(each) for each in zip(*parts, strict=True))
    return Result(
        means, scales, rotations, opacities, ((colours - 0.5) / C0)[:, None], z[:, 0],
        resized(found.confidence, height, width)[:, 0], **routing,
    )  # fmt: skip


def _placed(
    cameras: Cameras, view: int, images: Array, shares: tuple[Array, Array], z: Array, scale: Array, turn: Array
) -> list[Array]:
    """Means, scales and rotations in the world, from scales (3, h, w) in footprints and rotations (4, h, w)."""
    height, width = images.shape[2:]
    pose, k = cameras.poses[view], cameras.intrinsics[view]
    means = _last(cameras.rays(view, *shares) * z) @ pose[:3, :3].T + pose[:3, 3]
    footprint = z / np.sqrt(k[0, 0] * width * k[1, 1] * height)
    return [means, _last(scale * footprint), _product(_quaternion(pose[:3, :3]), _last(turn))]


def _backing(cameras: Cameras, view: int, images: Array, u: Array, kept: NDArray[np.bool_]) -> list[Array]:
    height, width = u.shape
    rows, columns = height // CELL, width // CELL
    cells = u.reshape(rows, CELL, columns, CELL)
    around = margin(cells.min((1, 3)), 1)
    far = np.min([around[a : a + rows, b : b + columns] for a in range(3) for b in range(3)], axis=0)
    weight = np.exp(-25 * (cells - far[:, None, :, None])).reshape(1, 1, height, width)
    colour = pooled(images[view : view + 1] * weight, CELL) / pooled(weight, CELL)
    opaque = 0.9 * (pooled(kept[None, None].astype(float), CELL) >= 0.5)
    far, colour, opaque = margin(far, 2).clip(0), margin(colour, 2)[0], margin(opaque, 2).reshape(-1)
    z = 1 / (0.93 * cameras.inverse(far))
    y, x = np.meshgrid(np.arange(-2, rows + 2) + 0.5, np.arange(-2, columns + 2) + 0.5, indexing="ij")
    shares = x * CELL / width, y * CELL / height
    scale = np.array([1, 1, 0.1])[:, None, None] * CELL * 0.6 * np.ones_like(z)
    turn = np.array([1.0, 0, 0, 0])[:, None, None] * np.ones_like(z)
    return [*_placed(cameras, view, images, shares, z, scale, turn), opaque, _last(colour)]
