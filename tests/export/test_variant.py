"""Variants of an export: experts per patch, and a network that skips nothing and gives the same result."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from gapmes.export.cli import app
from gapmes.export.graph import SceneGraph
from gapmes.export.samples import random_scene
from gapmes.export.variant import Variant, load_variant

SIZE = 64


def run(checkpoint: Path, variant: Variant, views: int, moved: float = 0.0) -> dict[str, np.ndarray]:
    """The outputs by name; `moved` shifts the last view so far to the side."""
    scene = random_scene(views, SIZE, SIZE, seed=3)
    scene.world_from_cam[-1, 0, 3] += moved
    graph = SceneGraph(load_variant(checkpoint, variant).network).eval()
    with torch.no_grad():
        return {name: value.numpy() for name, value in zip(graph.output_names, graph(*scene.tensors()), strict=True)}


@pytest.mark.case("S2")
@pytest.mark.parametrize(("views", "moved"), [(2, 0.0), (3, 0.0), (3, 1000.0)])
def test_a_network_that_skips_nothing_yields_the_same(checkpoint: Path, views: int, moved: float) -> None:
    """Also if a view shares nothing with the others, so that no pair with it is compared."""
    sparse = run(checkpoint, Variant(), views, moved)
    dense = run(checkpoint, Variant(keep_all=True), views, moved)
    for name, value in sparse.items():
        # a convolution may group its sums by the number of patches: measured 0, allowed the rounding of a few sums
        np.testing.assert_allclose(value, dense[name], rtol=0, atol=2e-6 * max(1.0, np.abs(value).max()))
    np.testing.assert_array_equal(sparse["expert_index"], dense["expert_index"])


def test_experts_per_patch_can_be_fewer_or_more(checkpoint: Path) -> None:
    for k in (1, 3):
        assert load_variant(checkpoint, Variant(top_k=k)).network.config.top_k == k
        outputs = run(checkpoint, Variant(top_k=k), 2)
        assert outputs["expert_index"].shape[-1] == k
        np.testing.assert_allclose(outputs["expert_weight"].sum(-1), 1, atol=3e-7)
    with pytest.raises(ValueError, match="top_k is 7, need 1 to 6"):
        load_variant(checkpoint, Variant(top_k=7))


def test_the_command_refuses_more_experts_than_there_are(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["--top-k", "0", "--size", "64x64", "-o", str(tmp_path / "x.onnx")])
    assert result.exit_code == 1
    assert "need 1 to 6" in result.output
