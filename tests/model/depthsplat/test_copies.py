"""A copy of the network reads its own position embedding."""

from __future__ import annotations

import copy

import torch
from random_checkpoint import randomised

from gapmes.model.depthsplat.config import DepthSplatConfig
from gapmes.model.depthsplat.network import DepthSplat
from gapmes.model.vit import resampled_positions


def test_a_copy_does_not_follow_changes_of_the_original() -> None:
    vit = randomised(DepthSplat(DepthSplatConfig("small", 1))).depth_predictor.pretrained
    other = copy.deepcopy(vit)
    images = torch.rand(1, 3, 56, 56, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        before = other(images)
        vit.vit.embeddings.position_embeddings.add_(1.0)
        assert all(torch.equal(a, b) for a, b in zip(before, other(images), strict=True))
        assert not torch.equal(vit(images)[0], before[0])


def test_positions_are_read_with_the_offset() -> None:
    embeddings = DepthSplat(DepthSplatConfig("small", 1)).depth_predictor.pretrained.vit.embeddings
    table = embeddings.position_embeddings
    assert torch.equal(embeddings.positions(4, 5), resampled_positions(table, 4, 5, 0.1))
    assert not torch.equal(embeddings.positions(4, 5), resampled_positions(table, 4, 5))
