"""Weights that are finite but overflow in use are refused with layer and weight, and no others are."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from small_networks import scene, tiny

from gapmes.model.checkpoint import load_checkpoint, save_checkpoint
from gapmes.model.network import GaPMeS
from gapmes.model.overflow import overflow
from gapmes.model.weights_file import CheckpointError


def with_weight(name: str, value: float) -> GaPMeS:
    """An untrained network in which one number is `value`."""
    network = tiny()
    network.get_parameter(name).data.view(-1)[0] = value
    return network


@pytest.mark.parametrize(
    ("weight", "layer"),
    [
        ("trunk.to_half.weight", "trunk.at_half.norm"),  # the index of a plane is no number then
        ("semantic.vit.encoder.layer.0.norm2.weight", "semantic.vit.encoder.layer.1.norm1"),  # Gaussians are not
    ],
)
def test_a_checkpoint_that_overflows_is_refused(weight: str, layer: str, tmp_path: Path) -> None:
    path = tmp_path / "great.safetensors"
    save_checkpoint(path, with_weight(weight, 1e38))
    with pytest.raises(CheckpointError) as refused:
        load_checkpoint(path)
    assert str(refused.value) == (
        f"{path}: layer {layer} overflows: it gives numbers that are not finite; the largest weight is 1e+38, in "
        f"{weight}; the file is damaged or was saved from a diverged run: take another file"
    )


def test_great_weights_that_do_no_harm_are_taken(tmp_path: Path) -> None:
    save_checkpoint(tmp_path / "great.safetensors", with_weight("heads.alpha.out.bias", 1e38))
    load_checkpoint(tmp_path / "great.safetensors")


def test_what_is_finite_in_the_end_is_no_overflow() -> None:
    network = torch.nn.Sequential(torch.nn.Linear(1, 1), torch.nn.Sigmoid())
    network[0].weight.data.fill_(3e38)
    assert overflow(network, lambda: network(torch.full((1, 1), 10.0))) == ""


def test_another_error_stays_itself() -> None:
    network = tiny()
    with pytest.raises(RuntimeError, match=r"shape|size"):
        overflow(network, lambda: network(*scene()[:3], torch.zeros(1, 5)))
    assert not any(module._forward_hooks for module in network.modules())


def test_the_largest_weight_may_be_negative() -> None:
    network = torch.nn.Sequential(torch.nn.Linear(1, 1), torch.nn.Linear(1, 1))
    network[0].weight.data.fill_(-3e38)
    found = overflow(network, lambda: network(torch.full((1, 1), 10.0)))
    assert found.startswith("layer 0 overflows: ")
    assert found.endswith("the largest weight is 3e+38, in 0.weight")
