"""Networks with ablations, other shapes or harmonics export, name their configuration, and agree with torch."""

from __future__ import annotations

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from gapmes.export.build import export_graph
from gapmes.export.cases import Case
from gapmes.export.graph import SceneGraph
from gapmes.export.samples import random_scene
from gapmes.export.tolerance import TOLERANCES
from gapmes.export.verification import verify
from gapmes.model.config import ModelConfig, preset
from gapmes.model.cost_volume import Views
from gapmes.model.depth import DepthEstimate
from gapmes.model.network import GaPMeS
from gapmes.model.trunk import TrunkFeatures


class DepthByBrightness(nn.Module):
    """What is bright is near; features are colours. In place of matching, half of a graph, which no ablation changes:
    it is tested with the shipped network and, of pictures that are not square, with the full one."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        mono = 0 if config.without_depth else config.stream_channels
        self.volume = nn.Conv2d(3 + mono, config.volume_channels, 1)
        self.guide = nn.Conv2d(3, config.refine_channels, 1)

    def forward(self, images: Tensor, _: TrunkFeatures, mono: Tensor, __: Views) -> DepthEstimate:
        """`mono` is joined as in matching: of a network without depth it has no channels."""
        half, quarter = F.avg_pool2d(images, 2), F.avg_pool2d(images, 4)
        full, refined, coarse = (colours.mean(1, keepdim=True) for colours in (images, half, quarter))
        volume = self.volume(torch.cat([quarter, mono], dim=1))
        return DepthEstimate(coarse, refined, refined, full, coarse, volume, self.guide(half))


@pytest.mark.parametrize(
    ("changes", "height", "width"),
    [
        ({"without_depth": True, "without_tasks": True, "sh_degree": 2}, 48, 80),
        ({"without_experts": True, "backing": False}, 32, 32),
    ],
)
def test_ablations_other_shapes_and_harmonics_export_and_agree(changes: dict, height: int, width: int) -> None:
    torch.manual_seed(0)
    network = GaPMeS(preset("tiny", **changes))
    network.depth = DepthByBrightness(network.config)  # type: ignore[assignment]
    model = export_graph(network.eval(), height, width)
    names = SceneGraph(network).output_names
    assert tuple(o.name for o in model.graph.output) == names
    assert ("expert_index" in names) == ("without_experts" not in changes)
    assert ("task_weight" in names) == ("without_tasks" not in changes)
    cases = [Case("random", "as trained", random_scene(v, height, width, seed=v)) for v in (2, 4)]
    for result in verify(model, network, cases, TOLERANCES["fp32"]):
        assert result.failures == []
