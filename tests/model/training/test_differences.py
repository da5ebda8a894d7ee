"""Comparing two configurations: every difference is named with both values, and nothing else."""

from __future__ import annotations

from dataclasses import asdict, replace

import pytest

from gapmes.model.config import PRESETS
from gapmes.model.training.differences import SHOWN, differences
from gapmes.model.training.recipe import Recipe


@pytest.mark.parametrize(
    ("found", "asked", "said"),
    [
        ({"a": 1, "b": 2}, {"a": 1, "b": 2}, ""),
        ({"a": 1, "b": 2}, {"a": 1, "b": 3}, "b is 2, asked for 3"),
        ({"a": 1}, {"b": None}, "a is 1, asked for nothing; b is nothing, asked for none"),
        ({"a": {"b": [1, {"c": 2}]}}, {"a": {"b": [1, {"c": 3}]}}, "a.b[1].c is 2, asked for 3"),
        ({"a": [1]}, {"a": [1, 2]}, "a[1] is nothing, asked for 2"),
        ("1", "2", "1, asked for 2"),
        (None, "x", "none, asked for x"),
    ],
)
def test_what_differs_is_named_with_both_values(found: object, asked: object, said: str) -> None:
    assert differences(found, asked) == said


def test_recipes_and_presets_are_told_apart_by_their_fields() -> None:
    assert differences(asdict(Recipe()), asdict(replace(Recipe(), steps=1, seed=2)), other="there") == (
        "steps is 8000, there 1; seed is 1, there 2"
    )
    told = differences(asdict(PRESETS["tiny"]), asdict(PRESETS["base"]))
    assert told.startswith("preset is tiny, asked for base; semantic_vit.hidden is 96, asked for 768; ")
    assert told.count("; ") == SHOWN
    assert told.endswith(" more")
