"""Networks with ablations, other shapes or harmonics export, name their configuration, and agree with torch."""

from __future__ import annotations

import pytest
import torch
from few_pieces import few_pieces

from gapmes.export.build import export_graph
from gapmes.export.cases import Case
from gapmes.export.graph import SceneGraph
from gapmes.export.samples import random_scene
from gapmes.export.tolerance import TOLERANCES
from gapmes.export.verify import verify
from gapmes.model.config import preset
from gapmes.model.network import GaPMeS


@pytest.mark.parametrize(
    ("changes", "height", "width"),
    [
        ({"without_depth": True, "without_tasks": True, "sh_degree": 2}, 48, 80),
        ({"without_experts": True, "backing": False}, 32, 32),
    ],
)
def test_ablations_other_shapes_and_harmonics_export_and_agree(changes: dict, height: int, width: int) -> None:
    torch.manual_seed(0)
    network = GaPMeS(preset("tiny", **changes)).eval()
    with few_pieces():
        model = export_graph(network, height, width)
    names = SceneGraph(network).output_names
    assert tuple(o.name for o in model.graph.output) == names
    assert ("expert_index" in names) == ("without_experts" not in changes)
    assert ("task_weight" in names) == ("without_tasks" not in changes)
    cases = [Case("random", "as trained", random_scene(v, height, width, seed=v)) for v in (2, 4)]
    for result in verify(model, network, cases, TOLERANCES["fp32"]):
        assert result.failures == []
