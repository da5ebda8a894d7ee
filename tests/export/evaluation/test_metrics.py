"""The figures against brute force in float64: PSNR and SSIM under masks, and what any LPIPS must obey."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from gapmes.export.evaluation.lpips import LAYERS, Lpips, default_weights
from gapmes.export.evaluation.metrics import Figures, figures, mean_figures
from gapmes.model.training import losses
from gapmes.service.errors import InputError
from gapmes.service.picture_error import psnr, ssim

RNG = np.random.default_rng(5)


def pictures(height: int = 40, width: int = 36) -> tuple[np.ndarray, np.ndarray]:
    """A smooth picture and a noisy copy, (3, H, W) float32."""
    a = F.interpolate(torch.from_numpy(RNG.random((1, 3, 6, 6))), size=(height, width), mode="bicubic")[0].clamp(0, 1)
    b = (a + 0.1 * torch.from_numpy(RNG.standard_normal(a.shape))).clamp(0, 1)
    return a.float().numpy(), b.float().numpy()


def some_pixels(shape: tuple[int, int]) -> np.ndarray:
    mask = RNG.random(shape) < 0.4
    mask[: shape[0] // 3] = False
    return mask


def test_masked_psnr_is_the_error_of_the_kept_pixels() -> None:
    a, b = pictures()
    mask = some_pixels(a.shape[1:])
    total, count = 0.0, 0
    for row, column in zip(*np.nonzero(mask), strict=True):
        for channel in range(3):
            total += (float(a[channel, row, column]) - float(b[channel, row, column])) ** 2
            count += 1
    assert psnr(a, b, mask) == pytest.approx(-10 * math.log10(total / count), abs=1e-9)


def test_masked_ssim_is_the_mean_of_windows_centred_in_the_mask() -> None:
    a, b = pictures(24, 22)
    mask = some_pixels((24, 22))
    offsets = np.arange(11) - 5
    kernel = np.exp(-(offsets[:, None] ** 2 + offsets[None] ** 2) / (2 * 1.5**2))
    kernel /= kernel.sum()
    values = []
    for row in range(5, 19):
        for column in range(5, 17):
            if not mask[row, column]:
                continue
            for channel in range(3):
                x, y = (p[channel, row - 5 : row + 6, column - 5 : column + 6].astype(np.float64) for p in (a, b))
                mx, my = (kernel * x).sum(), (kernel * y).sum()
                vx, vy = (kernel * x * x).sum() - mx**2, (kernel * y * y).sum() - my**2
                c = (kernel * x * y).sum() - mx * my
                top = (2 * mx * my + 1e-4) * (2 * c + 9e-4)
                values.append(top / ((mx**2 + my**2 + 1e-4) * (vx + vy + 9e-4)))
    assert ssim(a.astype(np.float64), b.astype(np.float64), mask) == pytest.approx(np.mean(values), abs=1e-9)


def test_with_a_full_mask_both_are_the_figures_of_training() -> None:
    a, b = pictures()
    full = np.ones(a.shape[1:], dtype=bool)
    one, other = torch.from_numpy(a)[None], torch.from_numpy(b)[None]
    assert psnr(a, b, full) == pytest.approx(float(losses.psnr(one, other)), abs=1e-4)  # float32 there
    assert ssim(a.astype(np.float64), b.astype(np.float64), full) == pytest.approx(
        float(losses.gaussian_ssim(one, other)), abs=1e-5
    )


def test_equal_pictures_and_empty_masks() -> None:
    a, b = pictures()
    full, none = np.ones(a.shape[1:], dtype=bool), np.zeros(a.shape[1:], dtype=bool)
    equal = figures(a, a, full, None)
    assert equal.psnr == pytest.approx(100)
    assert equal.ssim == pytest.approx(1)
    assert equal.lpips is None
    assert figures(a, b, none, None) == Figures(None, None, None)
    assert mean_figures([Figures(10, 0.5, None), Figures(None, None, None), Figures(20, 0.7, None)]) == Figures(
        15, pytest.approx(0.6), None
    )


def random_weights() -> dict[str, torch.Tensor]:
    """Of the right shapes; the linear layers are positive, as those of LPIPS are."""
    generator = torch.Generator().manual_seed(3)
    weights = {}
    for i, ((out, channels, kernel), _, _) in enumerate(LAYERS):
        spread = (channels * kernel**2) ** -0.5
        weights[f"net.{i}.weight"] = spread * torch.randn(out, channels, kernel, kernel, generator=generator)
        weights[f"net.{i}.bias"] = 0.1 * torch.randn(out, generator=generator)
        weights[f"NetLinLayer_{i}.0.weight"] = torch.rand(1, out, 1, 1, generator=generator)
    return weights


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
    """The published definition written out with a module per layer, in float64."""
    a, b = pictures(64, 80)
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
        Lpips(random_weights()).distance(*pictures(24, 24))
