"""LPIPS: the properties of any such distance, and a second implementation of the published definition in float64."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from random_lpips import random_weights

from gapmes.model.training.lpips import Lpips, default_weights
from gapmes.service.errors import InputError

RNG = np.random.default_rng(5)


@pytest.fixture(scope="module", params=["random", "trained"])
def lpips(request: pytest.FixtureRequest) -> Lpips:
    if request.param == "random":
        return Lpips(random_weights())
    path = default_weights()
    if path is None:
        pytest.skip("no LPIPS weights beside the checkout")
    return Lpips.load(path)


def blurred(picture: np.ndarray, radius: int) -> np.ndarray:
    padded = F.pad(torch.from_numpy(picture)[None], (radius,) * 4, mode="replicate")
    return F.avg_pool2d(padded, 2 * radius + 1, 1)[0].numpy()


def test_lpips_is_a_distance_that_grows_with_blur(lpips: Lpips) -> None:
    sharp = np.kron(RNG.random((3, 24, 24)), np.ones((1, 4, 4))).astype(np.float32)
    assert lpips.distance(sharp, sharp) == 0
    distances = [lpips.distance(sharp, blurred(sharp, radius)) for radius in (1, 2, 4, 8)]
    assert distances == sorted(distances)
    assert distances[0] > 0
    other = blurred(sharp, 3)
    assert lpips.distance(sharp, other) == pytest.approx(lpips.distance(other, sharp), rel=1e-6)
    assert lpips.distance(sharp, other, np.ones((96, 96), dtype=bool)) == pytest.approx(lpips.distance(sharp, other))


def test_lpips_under_a_mask_leaves_out_what_is_far_from_it(lpips: Lpips) -> None:
    a = RNG.random((3, 512, 128)).astype(np.float32)
    b = a.copy()
    b[:, 384:] = 0.5  # the deepest features see 195 px: none of the upper 128 rows reaches down to it
    mask = np.zeros((512, 128), dtype=bool)
    mask[:128] = True
    assert lpips.distance(a, b, mask) == 0
    assert lpips.distance(a, b, ~mask) > lpips.distance(a, b) > 0


def test_lpips_by_a_second_road(lpips: Lpips) -> None:
    """The published definition, written with a module per layer, in float64."""
    a, b = (RNG.random((3, 64, 80)).astype(np.float32) for _ in range(2))
    weights = {name: value.double() for name, value in lpips._weights.items()}
    shift, scale = torch.tensor([-0.030, -0.088, -0.188]).double(), torch.tensor([0.458, 0.448, 0.450]).double()
    total = 0.0
    x, y = (((2 * torch.from_numpy(p).double() - 1).permute(1, 2, 0) - shift) / scale for p in (a, b))
    x, y = x.permute(2, 0, 1)[None], y.permute(2, 0, 1)[None]
    for i, (stride, padding, pooled) in enumerate(((4, 2, 0), (1, 2, 1), (1, 1, 1), (1, 1, 0), (1, 1, 0))):
        layer = torch.nn.Conv2d(
            *weights[f"net.{i}.weight"].shape[1::-1], weights[f"net.{i}.weight"].shape[2], stride, padding
        )
        layer = layer.double()
        layer.load_state_dict({"weight": weights[f"net.{i}.weight"], "bias": weights[f"net.{i}.bias"]})
        pool = torch.nn.MaxPool2d(3, 2) if pooled else torch.nn.Identity()
        with torch.no_grad():
            x, y = (layer(pool(v)).relu() for v in (x, y))
        u, v = (F.normalize(z, dim=1, eps=1e-10) for z in (x, y))
        total += float(((u - v) ** 2 * weights[f"NetLinLayer_{i}.0.weight"]).sum(dim=1).mean())
    assert lpips.distance(a, b) == pytest.approx(total, rel=1e-4)  # float32 against float64, measured 2e-6


def test_lpips_names_a_wrong_tensor() -> None:
    weights = random_weights()
    weights["net.2.bias"] = torch.zeros(7)
    with pytest.raises(InputError, match=r"net\.2\.bias is \(7,\), need \(384,\)"):
        Lpips(weights)
    with pytest.raises(InputError, match="32"):
        Lpips(random_weights()).distance(*np.zeros((2, 3, 24, 24), np.float32))


def test_lpips_refuses_weights_that_are_not_finite() -> None:
    weights = random_weights()
    weights["net.1.bias"][:2] = torch.tensor([torch.nan, torch.inf])
    with pytest.raises(InputError, match=r"net\.1\.bias: 2 of 192 numbers are NaN or infinite"):
        Lpips(weights)


def test_lpips_under_a_mask_counts_the_covered_share_of_each_cell(lpips: Lpips) -> None:
    """Every second pixel covers about half of every cell, whichever these are: all cells count alike."""
    a, b = (RNG.random((3, 96, 128)).astype(np.float32) for _ in range(2))
    mask = np.indices((96, 128)).sum(axis=0) % 2 == 0
    for kept in (mask, ~mask):
        assert lpips.distance(a, b, kept) == pytest.approx(lpips.distance(a, b), rel=0.01)
