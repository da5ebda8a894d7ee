"""The table of what was left out, counted by hand: of patches, routes, Gaussians and bands, each with its error."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gapmes.service.document import GAUSSIANS
from gapmes.service.leaving_out.left_out import table
from gapmes.service.photographs.masks import FADED, MASKED, TRANSPARENT

PRUNED = {
    "kept": 60,
    "dropped": 20,
    "faint": 5,
    "faint_bound": 0.1,
    "unseen": 6,
    "bound": 0.15,
    "bands": [2, 1],
}
WEIGHTS = [[[0.6, 0.4], [1, 0], [0, 0]], [[0.5, 0.5], [1, 0], [1, 0]]]  # seven runs, of experts 0, 1 and 2
INDICES = [[[0, 1], [2, 3], [4, 5]], [[1, 0], [0, 4], [2, 5]]]


def rows(pruned: dict[str, Any], *, keep_all: bool = False, routed: bool = True, dropped: bool = True) -> dict:
    outputs = {"opacities": np.ones(100, np.float32)}
    if routed:
        outputs |= {"expert_weight": np.array(WEIGHTS), "expert_index": np.array(INDICES)}
    unpruned = SimpleNamespace(
        outputs=outputs,
        patch_mask=np.array([[True, True, False], [True, True, True]]),
        placed=SimpleNamespace(added=4),
        dropped={TRANSPARENT: 7, MASKED: 3, FADED: 2} if dropped else {},
    )
    info = SimpleNamespace(config={"experts": 6}, keep_all=keep_all)
    return {row.pop("what"): tuple(row.values()) for row in table(unpruned, info, pruned)}  # type: ignore[arg-type]


def test_every_row_is_counted() -> None:
    """Six patches of six experts; of 104 Gaussians 12 were dropped, 60 kept and 20 pruned, so that strides took 12."""
    assert rows(PRUNED) == {
        "patches under a mask": (1, 6, None),
        "runs of an expert on a patch": (29, 36, 0.0),
        "experts that no patch chose": (3, 6, 0.0),
        f"{GAUSSIANS}: {TRANSPARENT}": (7, 104, 0.0),
        f"{GAUSSIANS}: {MASKED}": (3, 104, None),
        f"{GAUSSIANS}: {FADED}": (2, 104, 0.0),
        f"{GAUSSIANS} between strides": (12, 104, None),
        f"{GAUSSIANS} below min_opacity": (5, 104, 0.1),
        f"{GAUSSIANS} without weight in the certified views": (6, 104, 0.0),
        f"{GAUSSIANS} within the budget": (9, 104, pytest.approx(0.05)),
        "bands of harmonics that are 0": (1, 2, 0.0),
    }


@pytest.mark.parametrize("without", [{"keep_all": True}, {"routed": False}])
def test_networks_that_run_all_or_have_no_experts_skip_none(without: dict[str, bool]) -> None:
    assert [what for what in rows(PRUNED, **without) if "expert" in what] == []


def test_what_is_none_has_no_row() -> None:
    nothing = {"kept": 104, "dropped": 0, "faint": 0, "faint_bound": 0.0, "unseen": 0, "bound": 0.0, "bands": [1, 1]}
    assert list(rows(nothing, routed=False, dropped=False)) == ["patches under a mask"]
