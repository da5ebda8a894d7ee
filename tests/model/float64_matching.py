"""Depth from matching in numpy and float64, written from docs/matching.md."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from float64_layers import (
    Array,
    Weights,
    margin,
    mean_inside,
    mean_repeated,
    pooled,
    resized,
    sampled,
    shuffled,
    softmax,
    unit,
    unshuffled,
)

PLANES = 64
BINS = np.linspace(0, 1, PLANES)


@dataclass(frozen=True)
class Cameras:
    """V cameras: intrinsics (V, 3, 3) over width and height, camera to world (V, 4, 4)."""

    intrinsics: Array
    poses: Array
    near: float
    far: float

    def inverse(self, u: Array) -> Array:
        return 1 / self.far + u * (1 / self.near - 1 / self.far)

    def rays(self, view: int, x: Array, y: Array) -> Array:
        """(3, ...) rays through positions as shares of width and height."""
        k = self.intrinsics[view]
        return np.stack([(x - k[0, 2]) / k[0, 0], (y - k[1, 2]) / k[1, 1], np.ones_like(x)])

    def seen(self, view: int, other: int, u: Array) -> tuple[Array, Array, Array, Array]:
        """For the view's pixels at u (..., h, w): their positions in the other's picture in px, whether they lie in it,
        and their u there."""
        h, w = u.shape[-2:]
        y, x = np.meshgrid((np.arange(h) + 0.5) / h, (np.arange(w) + 0.5) / w, indexing="ij")
        depth = 1 / self.inverse(u)
        points = self.rays(view, x, y).reshape(3, *[1] * (u.ndim - 2), h, w) * depth
        world = np.tensordot(self.poses[view][:3, :3], points, 1)
        world += self.poses[view][:3, 3].reshape(3, *[1] * u.ndim)
        back = np.linalg.inv(self.poses[other])
        there = np.tensordot(back[:3, :3], world, 1) + back[:3, 3].reshape(3, *[1] * u.ndim)
        k = self.intrinsics[other]
        before = there[2] > 1e-4 * depth
        z = np.where(before, there[2], 1)
        px, py = (there[i] / z * k[i, i] + k[i, 2] for i in (0, 1))
        inside = before & (px > 0) & (px < 1) & (py > 0) & (py < 1)
        inverse = np.where(before, 1 / z, 0)
        low, high = 1 / self.far, 1 / self.near
        beyond = [np.where(before & (np.abs(2 * p - 1) < 4), p, 2.5) for p in (px, py)]
        return beyond[0] * w - 0.5, beyond[1] * h - 0.5, inside, (inverse - low) / (high - low)

    def others(self, view: int) -> list[int]:
        return [other for other in range(len(self.poses)) if other != view]


def evidence(colours: Array, cameras: Cameras) -> Array:
    """(V, D, h, w) evidence of pictures (V, 3, h, w)."""
    colours = colours - colours.mean()
    views, _, h, w = colours.shape
    planes = np.broadcast_to(BINS[:, None, None], (PLANES, h, w))
    found = []
    for view in range(views):
        grey = colours[view].mean(0)
        mean, mean_square = mean_repeated(grey, 2), mean_repeated(grey**2, 2)
        scores = []
        for other in cameras.others(view):
            px, py, inside, _ = cameras.seen(view, other, planes)
            theirs = sampled(colours[other], px, py, repeat=True)
            b = theirs.mean(0)
            mean_b = mean_repeated(b, 2)
            variances = (mean_square - mean**2).clip(0) * (mean_repeated(b**2, 2) - mean_b**2).clip(0)
            covariance = mean_repeated(grey * b, 2) - mean * mean_b
            correlation = (covariance / np.sqrt(variances).clip(1e-3)).clip(-1, 1)
            difference = np.abs(theirs - colours[view][:, None]).mean(0).clip(None, 0.15) / 0.15
            scores.append(np.where(inside, (1 + correlation) / 4 + (1 - difference) / 2, 0.6))
        found.append(_guided(grey, np.mean(scores, axis=0)))
    return np.stack(found)


def _guided(grey: Array, score: Array) -> Array:
    mean, mean_score = mean_repeated(grey, 4), mean_repeated(score, 4)
    variance = mean_repeated(grey**2, 4) - mean**2 + 1e-3
    slope = (mean_repeated(grey * score, 4) - mean * mean_score) / variance
    return mean_repeated(slope, 4) * grey + mean_repeated(mean_score - slope * mean, 4)


def zncc(grey: Array) -> Array:
    """(V, 16, h / 2, w / 2) of grey pictures (V, 1, h, w)."""
    padded = margin(grey, 1)[:, 0]
    h, w = grey.shape[-2:]
    patch = np.stack([padded[:, row : row + h : 2, column : column + w : 2] for row in range(4) for column in range(4)])
    patch = (patch - patch.mean(0)).transpose(1, 0, 2, 3)
    return patch / np.sqrt((patch**2).sum(1, keepdims=True) + 0.016)


def matched(features: list[Array], u: Array, cameras: Cameras) -> tuple[list[Array], Array]:
    """Mean correlations at u (V, K, h, w), and the share of views that see the point."""
    totals, seen = [np.zeros_like(u) for _ in features], np.zeros_like(u)
    for view in range(len(u)):
        for other in cameras.others(view):
            px, py, inside, _ = cameras.seen(view, other, u[view])
            seen[view] += inside
            for total, feature in zip(totals, features, strict=True):
                theirs = sampled(feature[other], px, py, repeat=False)
                total[view] += (theirs * feature[view][:, None]).sum(0) * inside
    return [total / seen.clip(1) for total in totals], seen / (len(u) - 1)


def between_planes(values: Array, u: Array) -> Array:
    at = (u * (PLANES - 1)).clip(0, PLANES - 1)
    below = np.floor(at).clip(None, PLANES - 2).astype(int)
    share = at - below
    return np.take_along_axis(values, below, 1) * (1 - share) + np.take_along_axis(values, below + 1, 1) * share


def cues(u: Array, colours: Array, cameras: Cameras) -> Array:
    """(V, 4, h, w) cues of depths u (V, 1, h, w) and pictures (V, 3, h, w)."""
    found = []
    for view in range(len(u)):
        through, colour, seen = [], [], []
        for other in cameras.others(view):
            px, py, inside, there = cameras.seen(view, other, u[view, 0])
            theirs = sampled(np.concatenate([u[other], colours[other]]), px, py, repeat=True)
            through.append(np.tanh(16 * (there - theirs[0])) * inside)
            colour.append(np.abs(colours[view] - theirs[1:]).mean(0) * inside)
            seen.append(inside.astype(float))
        count = np.sum(seen, axis=0).clip(1)
        strongest = np.max(through, axis=0).clip(0)
        found.append([np.sum(through, 0) / count, strongest, np.sum(colour, 0) / count, np.mean(seen, 0)])
    return np.array(found)


def confirmed(cue: Array) -> Array:
    sure = 0.5 + (np.tanh(16 * 0.03) - np.abs(cue[:, :1])) / 0.2
    return sure.clip(0, 1) * (cue[:, 3:] > 0)


def filled(u: Array, sure: Array) -> Array:
    left, behind = np.ones_like(u), np.zeros_like(u)
    weight = sure * np.exp(-25 * u)
    for window in (5, 9, 17, 33):
        part = left * (mean_inside(sure, window // 2) / 0.03).clip(None, 1)
        behind += part * mean_inside(weight * u, window // 2) / mean_inside(weight, window // 2).clip(1e-15)
        left = left - part
    return sure * u + (1 - sure) * (behind + left * u)


def around(u: Array, count: int, planes: float) -> Array:
    offsets = np.linspace(-planes, planes, count) / (PLANES - 1)
    return (u + offsets[:, None, None]).clip(-0.02, 1.1)


@dataclass(frozen=True)
class Depth:
    coarse: Array
    confidence: Array
    volume: Array
    guide: Array
    full: Array


def depth(weights: Weights, images: Array, half: Array, quarter: Array, mono: Array, cameras: Cameras) -> Depth:
    """The depths of pictures (V, 3, H, W), from them and the trunk's features."""
    grey, colours = images.mean(1, keepdims=True) * 2 - 1, pooled(images)
    h, w = colours.shape[-2:]
    learned_gain, zncc_gain = weights["depth.learned_sharpness"], weights["depth.zncc_sharpness"]
    fixed_gain = weights["depth.evidence_sharpness"]

    descriptors = [unit(weights.convolved(quarter, "depth.match_quarter")), zncc(pooled(grey))]
    planes = np.broadcast_to(BINS[:, None, None], (len(images), PLANES, h // 2, w // 2))
    (learned, fixed), seen = matched(descriptors, planes, cameras)
    scores = evidence(colours, cameras)
    coarse_scores = pooled(scores)
    volume = np.concatenate([2 * learned, fixed, seen, quarter, mono, coarse_scores], axis=1)
    volume = weights.convolved(volume, "depth.volume_net.0")
    volume = weights.block(weights.block(volume, "depth.volume_net.1"), "depth.volume_net.2")
    logits = weights.convolved(volume, "depth.volume_logits")
    shares = softmax(logits + learned_gain[0] * learned + zncc_gain[0] * fixed + fixed_gain[0] * coarse_scores, 1)
    coarse = (shares * BINS[:, None, None]).sum(1, keepdims=True)
    confidence = shares.max(1, keepdims=True)

    start = (softmax(fixed_gain[1] * scores, 1) * BINS[:, None, None]).sum(1, keepdims=True)
    cue = cues(start, colours, cameras)
    sure = confirmed(cue)
    first = filled(start, sure)

    context = resized(quarter[:, : quarter.shape[1] // 4], h, w)
    descriptors = [unit(weights.convolved(np.concatenate([half, context], 1), "depth.match_half")), zncc(grey)]

    def looked_at(u: Array, stage: int) -> tuple[Array, Array]:
        (learned, fixed), seen = matched(descriptors, u, cameras)
        there = between_planes(scores, u)
        votes = learned_gain[stage] * learned + zncc_gain[stage] * fixed + fixed_gain[stage + 1] * there
        return np.concatenate([2 * learned, fixed, seen, there], axis=1), votes

    def mean(u: Array, logits: Array) -> Array:
        return (softmax(logits, 1) * u).sum(1, keepdims=True)

    candidates = np.concatenate([around(first, 9, 2), start, resized(coarse, h, w)], axis=1)
    found, votes = looked_at(candidates, 1)
    upwards = shuffled(weights.convolved(volume, "depth.volume_up"))
    pixels = unshuffled(images * 2 - 1)
    guide = np.concatenate([found, half, first, resized(confidence, h, w), upwards, pixels, cue, sure], axis=1)
    guide = weights.convolved(guide, "depth.refine_net.0")
    guide = weights.block(weights.block(guide, "depth.refine_net.1"), "depth.refine_net.2")
    refined = mean(candidates, weights.convolved(guide, "depth.refine_logits") + sure * votes)

    candidates = around(refined, 5, 0.5)
    found, votes = looked_at(candidates, 2)
    more = np.concatenate([guide, found, cues(refined, colours, cameras)], axis=1)
    guide = guide + weights.block(weights.convolved(more, "depth.second_net.0"), "depth.second_net.1")
    second = mean(candidates, weights.convolved(guide, "depth.second_logits") + votes)

    shares = softmax(weights.convolved(guide, "depth.up_mask").reshape(len(images), 9, 4, h, w), 1)
    padded = margin(second, 1)
    near = np.stack([padded[:, :, row : row + h, column : column + w] for row in range(3) for column in range(3)], 1)
    return Depth(coarse, confidence, volume, guide, shuffled((shares * near).sum(1)))
