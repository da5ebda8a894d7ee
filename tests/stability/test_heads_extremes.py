"""The heads at their limits: quaternions of any length, scales of any logit, and non-finite numbers."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest
import torch
from torch import Tensor, nn

from gapmes.model.config import preset
from gapmes.model.geometry import quaternion_to_matrix
from gapmes.model.heads import SCALE_FLOOR, SCALE_GAIN, Heads, unit_quaternions
from gapmes.service.gaussians import Gaussians

IDENTITY = torch.tensor([1.0, 0, 0, 0]).reshape(1, 4, 1, 1)
LENGTHS = [1e-45, 1e-44, 1e-40, 1e-38, 1e-30, 1e-23, 1e-8, 1e-4, 1.0, 1e4, 1e19, 1e30, 1e38]


def exact_rotation(wxyz: np.ndarray) -> np.ndarray:
    """(3, 3) of a quaternion of any length, in 60 digits."""
    with mp.workdps(60):
        w, x, y, z = (mp.mpf(float(v)) for v in wxyz)
        n = w * w + x * x + y * y + z * z
        rows = [
            [1 - 2 * (y * y + z * z) / n, 2 * (x * y - w * z) / n, 2 * (x * z + w * y) / n],
            [2 * (x * y + w * z) / n, 1 - 2 * (x * x + z * z) / n, 2 * (y * z - w * x) / n],
            [2 * (x * z - w * y) / n, 2 * (y * z + w * x) / n, 1 - 2 * (x * x + y * y) / n],
        ]
        return np.array([[float(v) for v in row] for row in rows])


@pytest.mark.case("A1")
@pytest.mark.parametrize("length", LENGTHS)
def test_quaternions_of_any_length_are_the_same_rotation(length: float) -> None:
    """Both of the network's heads and of sets of Gaussians; denormals are as exact as float32 holds them."""
    rng = np.random.default_rng(0)
    raw = rng.standard_normal((40, 4))
    raw = (length * raw / np.linalg.norm(raw, axis=1, keepdims=True)).astype(np.float32)
    raw = raw[raw.any(axis=1)]  # the smallest denormal rounds some to zero
    head = unit_quaternions(torch.from_numpy(raw).T.reshape(1, 4, 1, -1), IDENTITY)[0, :, 0].T
    count = len(raw)
    made = Gaussians.make(
        np.zeros((count, 3)), np.ones((count, 3)), raw, np.ones(count), np.zeros((count, 1, 3))
    ).rotations_wxyz
    exact = np.stack([exact_rotation(row) for row in raw])
    for unit in (head, torch.from_numpy(made)):
        matrices = quaternion_to_matrix(unit.double())
        product = matrices.transpose(1, 2) @ matrices
        orthonormal = float((product - torch.eye(3, dtype=torch.float64)).abs().max())
        assert orthonormal < 2e-6
        assert np.abs(matrices.numpy() - exact).max() < 2e-6  # measured 3.5e-7, of the identity 6.9e-7


@pytest.mark.case("A1")
@pytest.mark.parametrize("length", [1e-320, 1e-310, 1e-200, 1e-100, 1e-46, 1e-45, 1e-42, 1e-38, 1.0, 1e38])
def test_quaternions_in_float64_keep_their_direction_whatever_float32_makes_of_them(length: float) -> None:
    """Cast to float32 first, one of 1e-200 was all zeros, and so the identity; one of 1e-42 had three digits."""
    rng = np.random.default_rng(1)
    wide = length * rng.choice([-1.0, 1.0], (40, 4)) * np.exp(rng.uniform(-3, 0, (40, 4)))
    wide[0] = 0.0
    wide[1:5] = length * np.eye(4)
    count = len(wide)
    others = np.zeros((count, 3)), np.ones((count, 3)), np.ones(count), np.zeros((count, 1, 3))
    made = Gaussians.make(*others[:2], wide, *others[2:]).rotations_wxyz
    assert made[0].tolist() == [1, 0, 0, 0]
    exact = np.stack([exact_rotation(row) for row in wide[1:]])
    assert np.abs(quaternion_to_matrix(torch.from_numpy(made[1:]).double()).numpy() - exact).max() < 2e-6
    kept = wide.copy()
    Gaussians.make(*others[:2], kept, *others[2:])
    assert np.array_equal(kept, wide)  # what was given is not written to


@pytest.mark.case("A1")
def test_a_quaternion_of_zeros_is_the_identity_without_a_word() -> None:
    """It is a legal value that is not counted; one that is not finite is refused by its field, index and count."""
    rows = np.float32([[1, 0, 0, 0], [0, 0, 0, 0], [-0.0, 0, -0.0, 0], [0, 1, 0, 0]])
    made = Gaussians.make(np.zeros((4, 3)), np.ones((4, 3)), rows, np.ones(4), np.zeros((4, 1, 3)))
    assert made.rotations_wxyz.tolist() == [[1, 0, 0, 0], [1, 0, 0, 0], [1, 0, 0, 0], [0, 1, 0, 0]]
    head = unit_quaternions(torch.from_numpy(rows).T.reshape(1, 4, 1, 4), IDENTITY)
    assert torch.equal(head[0, :, 0].T, torch.from_numpy(made.rotations_wxyz))


class Fixed(nn.Module):
    """A head that returns given numbers."""

    def __init__(self, values: Tensor) -> None:
        super().__init__()
        self.values = values

    def forward(self, *_: Tensor) -> Tensor:
        return self.values


def heads_with(epsilon: Tensor) -> Heads:
    torch.manual_seed(0)
    heads = Heads(preset("tiny"), 16).eval()
    heads.epsilon = Fixed(epsilon)
    return heads


@pytest.mark.case("A2")
def test_scales_of_any_logit_are_finite_monotone_and_in_range() -> None:
    """Scales go through a softplus and never through a ReLU: none is zero, the least is a quarter of a pixel."""
    raw = np.unique(np.concatenate([[0.0], *(s * np.geomspace(1e-6, 1e4, 400) for s in (1, -1))])).astype(np.float32)
    epsilon = torch.zeros(1, 7, 1, len(raw))
    epsilon[0, :3, 0] = torch.from_numpy(raw)
    config = preset("tiny")
    with torch.no_grad():
        maps, guide = [torch.zeros(1, 16, 8, 8)] * 4, torch.zeros(1, config.refine_channels, 16, 16)
        scale = heads_with(epsilon)(maps, guide).scale[0, 0, 0].double().numpy()
    with mp.workdps(60):
        logits = [min(3 * mp.mpf(float(v)) - mp.mpf("1.5"), mp.mpf(20)) for v in raw]
        exact = np.array([float(SCALE_FLOOR + SCALE_GAIN * mp.log1p(mp.exp(v))) for v in logits])
    assert np.isfinite(scale).all()
    assert (np.diff(scale) >= 0).all()
    assert scale.min() >= SCALE_FLOOR
    assert scale.max() <= SCALE_FLOOR + SCALE_GAIN * 20.001
    assert np.abs(scale / exact - 1).max() < 5e-7  # measured 1.5e-7


@pytest.mark.case("A1", "A2")
@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_features_that_are_no_numbers_show_in_the_outputs(value: float) -> None:
    """The rotation of a pixel whose head is NaN becomes the identity, but its scale, of the same features, does not.

    So the engine, which refuses outputs that are not finite, hears of it.
    """
    torch.manual_seed(0)
    config = preset("tiny")
    heads, maps = Heads(config, 16).eval(), [torch.randn(1, 16, 8, 8) for _ in range(4)]
    for features in maps:
        features[0, 3, 4, 5] = value
    with torch.no_grad():
        out = heads(maps, torch.randn(1, config.refine_channels, 16, 16))
    assert torch.isnan(out.scale).any()
    assert torch.isnan(out.offset).any()
    unnamed = ~torch.isfinite(out.rotation).all(1) & torch.isfinite(out.scale).all(1)
    assert not unnamed.any()
