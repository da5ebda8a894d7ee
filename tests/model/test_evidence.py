"""Matching without training: equals a brute-force twin in float64, finds a wall at its depth, and keeps edges."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from gapmes.model.cost_volume import Views
from gapmes.model.evidence import (
    COLOUR_LIMIT,
    FLAT,
    GUIDE_EPSILON,
    GUIDE_RADIUS,
    UNSEEN,
    WINDOW_RADIUS,
    at_candidates,
    matching_evidence,
)

SIZE, PLANES = 20, 9
NEAR, FAR = 1.0, 8.0


def sideways(baseline: float, views: int = 2) -> Views:
    intrinsics = torch.tensor([[1.0, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1]]).expand(1, views, 3, 3)
    poses = torch.eye(4).repeat(1, views, 1, 1)
    poses[0, :, 0, 3] = baseline * torch.arange(views)
    return Views.make(intrinsics, poses, torch.tensor([[NEAR, FAR]]))


def box(values: np.ndarray, radius: int) -> np.ndarray:
    padded = np.pad(values, radius, mode="edge")
    out = np.empty_like(values)
    for y in range(values.shape[0]):
        for x in range(values.shape[1]):
            out[y, x] = padded[y : y + 2 * radius + 1, x : x + 2 * radius + 1].mean()
    return out


def brute_force(a: np.ndarray, b: np.ndarray, shift: float) -> np.ndarray:
    """The evidence of one plane for picture a, when b shows it `shift` px further left; (3, H, W) float64."""
    w = a.shape[2]
    x = np.arange(w) - shift
    inside = (x > -0.5) & (x < w - 0.5)
    clipped = x.clip(0, w - 1)
    low = np.floor(clipped).astype(int).clip(0, w - 2)
    t = clipped - low
    warped = b[:, :, low] * (1 - t) + b[:, :, low + 1] * t
    grey_a, grey_b = a.mean(0), warped.mean(0)
    mean_a, mean_b = box(grey_a, WINDOW_RADIUS), box(grey_b, WINDOW_RADIUS)
    var_a = box(grey_a**2, WINDOW_RADIUS) - mean_a**2
    var_b = box(grey_b**2, WINDOW_RADIUS) - mean_b**2
    covariance = box(grey_a * grey_b, WINDOW_RADIUS) - mean_a * mean_b
    correlation = np.clip(covariance / np.sqrt(np.maximum(var_a * var_b, 0)).clip(min=FLAT), -1, 1)
    difference = np.abs(warped - a).mean(0).clip(max=COLOUR_LIMIT) / COLOUR_LIMIT
    score = np.where(inside[None], 0.25 * (1 + correlation) + 0.5 * (1 - difference), UNSEEN)
    mean_g, mean_s = box(grey_a, GUIDE_RADIUS), box(score, GUIDE_RADIUS)
    slope = (box(grey_a * score, GUIDE_RADIUS) - mean_g * mean_s) / (
        box(grey_a**2, GUIDE_RADIUS) - mean_g**2 + GUIDE_EPSILON
    )
    return box(slope, GUIDE_RADIUS) * grey_a + box(mean_s - slope * mean_g, GUIDE_RADIUS)


@pytest.mark.case("P11")
def test_equals_brute_force_in_float64() -> None:
    baseline = 0.6
    images = torch.rand(2, 3, SIZE, SIZE, generator=torch.Generator().manual_seed(0))
    got = matching_evidence(images, sideways(baseline), PLANES)
    first, second = images.double().numpy()
    for plane, t in enumerate(np.linspace(0, 1, PLANES)):
        inverse = 1 / FAR + t * (1 / NEAR - 1 / FAR)
        shift = baseline * inverse * SIZE
        # measured 2.2e-7: float32 rounding through two divisions by small variances
        np.testing.assert_allclose(got[0, plane], brute_force(first, second, shift), atol=1e-6)
        mirrored = brute_force(second[:, :, ::-1], first[:, :, ::-1], shift)[:, ::-1]
        np.testing.assert_allclose(got[1, plane], mirrored, atol=1e-6)


@pytest.mark.case("P11")
def test_brightness_costs_no_precision() -> None:
    """A texture of little contrast, near white: without centring, mean squares of 0.9 would lose their difference."""
    texture = 0.92 + 0.04 * torch.rand(2, 3, SIZE, SIZE, generator=torch.Generator().manual_seed(3))
    got = matching_evidence(texture, sideways(0.6), PLANES)
    first, second = texture.double().numpy()
    for plane, t in enumerate(np.linspace(0, 1, PLANES)):
        shift = 0.6 * (1 / FAR + t * (1 / NEAR - 1 / FAR)) * SIZE
        np.testing.assert_allclose(got[0, plane], brute_force(first, second, shift), atol=5e-7)  # measured 7.3e-8


@pytest.mark.case("P1")
def test_a_textured_wall_scores_best_at_its_depth() -> None:
    """One wall at the fifth of nine planes: both pictures are cut from it and differ by a whole-pixel shift."""
    inverse = 1 / FAR + 0.5 * (1 / NEAR - 1 / FAR)
    shift = 4
    baseline = shift / (inverse * SIZE)
    wall = torch.rand(3, SIZE, SIZE + shift, generator=torch.Generator().manual_seed(1))
    images = torch.stack([wall[:, :, :SIZE], wall[:, :, shift:]])
    evidence = matching_evidence(images, sideways(baseline), PLANES)
    assert (evidence[0, :, :, shift + 5 :].argmax(0) == 4).all()
    assert (evidence[1, :, :, : SIZE - shift - 5].argmax(0) == 4).all()
    assert float(evidence[0, 4, :, shift + 5 :].min()) > 0.95


@pytest.mark.case("P8")
@pytest.mark.parametrize("grey", [0.0, 0.5, 1.0])
def test_pictures_of_one_colour_say_nothing(grey: float) -> None:
    evidence = matching_evidence(torch.full((3, 3, SIZE, SIZE), grey), sideways(0.1, 3), PLANES)
    assert torch.isfinite(evidence).all()
    # equal colours without correlation score 0.75 on every plane, however deep; the rest is what other views miss
    assert float((evidence.amax(3)[0] - 0.75).abs().max()) < 1e-3
    assert UNSEEN - 1e-3 < float(evidence.min()) <= float(evidence.max()) < 0.751


def test_views_that_share_nothing_leave_the_unseen_score() -> None:
    images = torch.rand(2, 3, SIZE, SIZE, generator=torch.Generator().manual_seed(2))
    evidence = matching_evidence(images, sideways(40.0), PLANES)
    assert float((evidence - UNSEEN).abs().max()) < 1e-5


def test_reading_between_planes() -> None:
    evidence = torch.arange(5.0).reshape(1, 5, 1, 1) ** 2
    candidates = torch.tensor([-0.2, 0.0, 0.125, 0.5, 0.9, 1.0, 1.3]).reshape(1, 7, 1, 1)
    got = at_candidates(evidence, candidates).flatten().tolist()
    assert got == pytest.approx([0.0, 0.0, 0.5, 4.0, 13.2, 16.0, 16.0], abs=1e-5)


def test_of_several_views_it_is_the_mean() -> None:
    """The filter is linear in the scores: three views have the mean of what the pairs have, but for their centring."""
    images = torch.rand(3, 3, SIZE, SIZE, generator=torch.Generator().manual_seed(5))
    images = images - images.mean((1, 2, 3), keepdim=True) + 0.5
    intrinsics = torch.tensor([[1.0, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1]])
    poses = torch.eye(4).repeat(3, 1, 1)
    poses[:, 0, 3] = torch.tensor([0.0, 0.3, -0.5])

    def of(which: list[int]) -> torch.Tensor:
        some = intrinsics.expand(1, len(which), 3, 3), poses[which][None], torch.tensor([[NEAR, FAR]])
        return matching_evidence(images[which], Views.make(*some), PLANES)[0]

    torch.testing.assert_close(of([0, 1, 2]), (of([0, 1]) + of([0, 2])) / 2, atol=2e-6, rtol=0)
