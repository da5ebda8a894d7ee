"""The rows about what a scene did without: every number of a small example is counted by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gapmes.service.leaving_out.left_out import table
from gapmes.service.photographs.masks import FADED, MASKED, REPLACED, TRANSPARENT

# Two views of three patches, of which each may take two of five experts; the last patch is under a mask.
INDEX = np.array([[[0, 1], [0, 3], [1, 0]], [[3, 0], [0, 1], [2, 2]]])
WEIGHT = np.array([[[0.6, 0.4], [1.0, 0.0], [0.5, 0.5]], [[0.7, 0.3], [1.0, 0.0], [0.0, 0.0]]])
MASK = np.array([[True, True, True], [True, True, False]])
PRUNED = {
    "kept": 60, "dropped": 15, "faint": 3, "unseen": 10, "faint_bound": 0.001, "bound": 0.003, "bands": [3, 1]
}  # fmt: skip
EXPERTS = [
    {"what": "runs of an expert on a patch", "count": 30 - 8, "of": 30, "error": 0.0},
    {"what": "experts that no patch chose", "count": 2, "of": 5, "error": 0.0},
]


ROUTES = {"expert_index": INDEX, "expert_weight": WEIGHT}
DROPPED = {TRANSPARENT: 4, FADED: 1, REPLACED: 2, MASKED: 3}


@pytest.mark.parametrize(
    ("config", "keep_all", "routes", "experts"),
    [
        ({"experts": 5}, False, ROUTES, EXPERTS),
        ({"experts": 5}, True, ROUTES, []),
        ({"experts": 5}, False, {}, []),
        ({}, False, ROUTES, []),
    ],
)
def test_everything_that_was_left_out_has_a_row(
    config: dict[str, Any], keep_all: bool, routes: dict[str, Any], experts: list[dict[str, Any]]
) -> None:
    """What experts did without only where the network has them, does without it and says how many it has."""
    scene: Any = SimpleNamespace(
        outputs={"opacities": np.zeros(90)} | routes,
        patch_mask=MASK,
        dropped=DROPPED,
        placed=SimpleNamespace(added=10),
    )
    info: Any = SimpleNamespace(experts=config.get("experts"), keep_all=keep_all)
    found = table(scene, info, PRUNED)
    bound = [row.pop("error") for row in found if row["what"] == "Gaussians within the budget"]
    assert bound == [pytest.approx(0.003 - 0.001)]
    assert found == [
        {"what": "patches under a mask", "count": 1, "of": 6, "error": None},
        *experts,
        {"what": f"Gaussians: {TRANSPARENT}", "count": 4, "of": 100, "error": 0.0},
        {"what": f"Gaussians: {FADED}", "count": 1, "of": 100, "error": 0.0},
        {"what": f"Gaussians: {REPLACED}", "count": 2, "of": 100, "error": None},
        {"what": f"Gaussians: {MASKED}", "count": 3, "of": 100, "error": None},
        {"what": "Gaussians between strides", "count": 100 - 10 - 75, "of": 100, "error": None},
        {"what": "Gaussians below min_opacity", "count": 3, "of": 100, "error": 0.001},
        {"what": "Gaussians without weight in the certified views", "count": 10, "of": 100, "error": 0.0},
        {"what": "Gaussians within the budget", "count": 15 - 10 - 3, "of": 100},
        {"what": "bands of harmonics that are 0", "count": 2, "of": 3, "error": 0.0},
    ]


def test_what_is_none_has_no_row() -> None:
    nothing = {"kept": 90, "dropped": 0, "faint": 0, "faint_bound": 0.0, "unseen": 0, "bound": 0.0, "bands": [1, 1]}
    scene: Any = SimpleNamespace(
        outputs={"opacities": np.zeros(90)},
        patch_mask=np.ones((2, 3), bool),
        dropped={},
        placed=SimpleNamespace(added=0),
    )
    assert table(scene, SimpleNamespace(experts=None, keep_all=False), nothing) == []  # type: ignore[arg-type]
