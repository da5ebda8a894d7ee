"""Quality floors of a shipped network, each with the measured value, passed or missed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .scores import BASELINES, SIMPLE, Group

GENERATED_MARGIN = 2.5  # dB above the best baseline, mean over scenes
TWO_VIEW_MARGIN = 2.5
THREE_VIEW_MARGIN = 1.5
TWICE_CHANGE = 1.5  # dB of difference between twice the size and the size itself
TWICE_HOLES = 0.01  # share of pixels
EXPERT_SHARE = 0.03  # of the top-k choices


@dataclass(frozen=True)
class Floor:
    """One requirement; `passed` is None where it was not measured."""

    name: str
    need: str
    value: str
    passed: bool | None


def floors(groups: Sequence[Group]) -> list[Floor]:
    """All floors, for the first model of each group, at every evaluated size."""
    result = []
    for kind, inputs, need in (
        ("generated", 2, GENERATED_MARGIN),
        ("photographs", 2, TWO_VIEW_MARGIN),
        ("photographs", 3, THREE_VIEW_MARGIN),
    ):
        matching = [g for g in groups if (g.kind, g.inputs) == (kind, inputs)]
        if not matching:
            name = f"{kind}, {inputs} views: mean above each scene's best baseline"
            result.append(Floor(name, f">= +{need} dB", "not measured", None))
        for group in matching:
            for among, which in ((SIMPLE, "simple baseline"), (BASELINES, "baseline")):
                result.append(_above(group, among, which, need))
                if (kind, inputs) == ("photographs", 2):
                    result.append(_on_every_scene(group, among, which))
    return [*result, *_twice(groups), _covered(groups), *_experts(groups)]


def _above(group: Group, among: Sequence[str], which: str, need: float) -> Floor:
    mean = float(np.mean(group.margins(group.models[0], among)))
    name = f"{group.title}: mean above each scene's best {which}"
    return Floor(name, f">= +{need} dB", f"{mean:+.2f} dB", mean >= need)


def _on_every_scene(group: Group, among: Sequence[str], which: str) -> Floor:
    model = group.models[0]
    worst = min(group.scenes, key=lambda scene: scene.margin(model, among))
    margin = worst.margin(model, among)
    name = f"{group.title}: above the best {which} on every scene"
    return Floor(name, "> 0 dB", f"{margin:+.2f} dB ({worst.scene})", margin > 0)


def _twice(groups: Sequence[Group]) -> list[Floor]:
    """Floors of the worst scene of all groups that were rendered at twice the size."""
    drawn = [(g, s, twice) for g in groups for s in g.scenes if (twice := s.models[g.models[0]].twice) is not None]
    changes = [(abs(twice.change), f"{scene.scene}; {group.title}") for group, scene, twice in drawn]
    holes = [(twice.holes, f"{scene.scene}; {group.title}") for group, scene, twice in drawn]
    near, few = f"within {TWICE_CHANGE} dB", f"< {100 * TWICE_HOLES:g} %"
    return [
        _worst("twice the size: PSNR on every scene", near, changes, "{:.2f} dB", TWICE_CHANGE),
        _worst("twice the size: holes on every scene", few, holes, "{:.3%}", TWICE_HOLES),
    ]


def _worst(name: str, need: str, values: Sequence[tuple[float, str]], form: str, limit: float) -> Floor:
    """The floor that the largest of the (value, where measured) pairs is below `limit`."""
    if not values:
        return Floor(name, need, "not measured", None)
    value, where = max(values)
    return Floor(name, need, f"{form.format(value)} ({where})", value < limit)


def _covered(groups: Sequence[Group]) -> Floor:
    """The floor that no co-visible pixel is a hole."""
    entries = [
        (scene.models[g.models[0]].holes_covisible, f"{scene.scene}; {g.title}") for g in groups for scene in g.scenes
    ]
    shares = [(share, where) for share, where in entries if share is not None]
    name, need = "holes in co-visible pixels", "none"
    if not shares:
        return Floor(name, need, "not measured", None)
    share, where = max(shares)
    return Floor(name, need, f"{share:.4%} ({where})" if share > 0 else "none", share == 0)


def _experts(groups: Sequence[Group]) -> list[Floor]:
    """Floors on the share of the least used expert of each group; none for networks without experts."""
    result = []
    for group in groups:
        statistics = group.routing[group.models[0]]
        if statistics is not None and statistics.expert_share:
            least = min(statistics.expert_share)
            name = f"least used expert, {group.title}"
            result.append(Floor(name, f">= {100 * EXPERT_SHARE:g} %", f"{least:.1%}", least >= EXPERT_SHARE))
    return result
