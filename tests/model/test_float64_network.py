"""The shipped network agrees with an implementation from its documentation, in float64 and without torch."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
import torch
from float64_layers import Array, Weights
from float64_matching import Cameras
from float64_network import C0, Result, network
from PIL import Image
from safetensors.numpy import load_file

from gapmes.model.checkpoint import load_checkpoint, shipped_checkpoint

SAMPLE = Path(__file__).parents[2] / "service" / "assets" / "sample"
LEFT, TOP, WIDTH, HEIGHT = 80, 96, 96, 64  # px: not square, so that no axis stands for another one
NEAR, FAR = 1.647, 4.809
NARROW = 2.2, 2.9  # within the sample's depths: the network finds some before and some behind it
ROUNDING = 2e-8  # of an output's largest value; measured: 2.1e-9


@pytest.fixture
def doubles() -> Iterator[None]:
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(torch.float32)


def sample(views: list[int], near: float = NEAR, far: float = FAR) -> tuple[Array, Cameras]:
    """A part of the sample's photographs, and its cameras in the frame of the first."""
    document = json.loads((SAMPLE / "cameras.json").read_text())
    pictures, intrinsics, poses = [], [], []
    for view in views:
        entry = document["views"][view]
        with Image.open(SAMPLE / "images" / f"{view:03d}.png") as picture:
            part = picture.convert("RGB").crop((LEFT, TOP, LEFT + WIDTH, TOP + HEIGHT))
        pictures.append(np.asarray(part, np.float64).transpose(2, 0, 1) / 255)
        k = np.array([[entry["fx"], 0, entry["cx"] - LEFT], [0, entry["fy"], entry["cy"] - TOP], [0, 0, 1]])
        intrinsics.append(k / [[WIDTH], [HEIGHT], [1]])
        pose = np.array(entry["c2w"])
        u, _, v = np.linalg.svd(pose[:3, :3])  # to a rotation in float64: the file has nine digits
        pose[:3, :3] = u @ v
        poses.append(pose)
    return np.stack(pictures), Cameras(np.stack(intrinsics), np.linalg.inv(poses[0]) @ np.stack(poses), near, far)


@pytest.mark.usefixtures("doubles")
@pytest.mark.parametrize("views", [[1, 5], [0, 3, 6]])
def test_the_network_is_the_documented_one(views: list[int]) -> None:
    assert_documented(*sample(views))


@pytest.mark.usefixtures("doubles")
def test_its_limits_are_the_documented_ones() -> None:
    """Inverse depths, colours and sizes are clamped, and points lie behind a camera or just in front of it."""
    images, cameras = sample([1, 5, 3], *NARROW)
    images = (2 * images - 0.5).clip(0, 1)
    cameras.poses[2, :3, 3] += 2.4 * cameras.poses[2, :3, 2]
    more = {
        "heads.mu.out.bias": np.repeat([0.0, 0.0, -3.0], 4),
        "heads.epsilon.out.bias": np.tile([6.0, 0.0], 14),
        "heads.colour.out.bias": np.tile([3.0, -3.0], 6),
    }
    expected = assert_documented(images, cameras, more)
    colours = expected.harmonics * C0 + 0.5
    assert (colours.min(), colours.max()) == pytest.approx((-0.1, 1.1), rel=1e-12)
    assert expected.depth.max() == pytest.approx(cameras.far, rel=1e-12)


def assert_documented(images: Array, cameras: Cameras, more: Mapping[str, Array] = MappingProxyType({})) -> Result:
    """Both agree, with the shipped weights plus `more`; returns the expected result."""
    path = shipped_checkpoint("tiny")
    weights = {name: each.astype(np.float64) + more.get(name, 0.0) for name, each in load_file(path).items()}
    torch_network = load_checkpoint(path).double().eval()
    torch_network.load_state_dict({name: torch.from_numpy(weights[name]) for name in more}, strict=False)
    views = len(images)
    mask = np.ones((views, WIDTH * HEIGHT // 256), np.bool_)
    mask[-1, 7:9] = False
    expected = network(Weights(weights), images, cameras, mask)
    with torch.no_grad():
        given = [torch.from_numpy(each)[None] for each in (images, cameras.intrinsics, cameras.poses)]
        found = torch_network(*given, torch.tensor([[cameras.near, cameras.far]]), torch.from_numpy(mask)[None])
    routing = found.routing
    np.testing.assert_array_equal(routing.expert_index, expected.expert_index)
    for name, value in {
        **{name: getattr(found.gaussians, name)[0] for name in vars(found.gaussians)},
        "depth": found.depth[0], "confidence": found.confidence[0], "expert_weight": routing.expert_weight,
        "task_weight": routing.task_weight, "route_margin": routing.margin,
    }.items():  # fmt: skip
        reference = getattr(expected, name)
        assert value.shape == reference.shape, name
        assert value.dtype == torch.float64, name
        assert np.abs(value.numpy() - reference).max() < ROUNDING * np.abs(reference).max(), name
    return expected
