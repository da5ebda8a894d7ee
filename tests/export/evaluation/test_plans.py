"""The plans of `gapmes evaluate`: sizes, views and counts, and the generated scenes of a seed."""

from __future__ import annotations

import numpy as np

from gapmes.export.evaluation.case import GENERATED_SEED, generated_cases
from gapmes.export.evaluation.plans import evaluation_plans
from gapmes.export.size import Size
from gapmes.model.training.validation import VALIDATION_SEED
from gapmes.service.shipped import sample_folder, shipped_model


def test_plans() -> None:
    folder = sample_folder()
    plans = evaluation_plans([folder], None, [], [], [])
    assert [(p.kind, p.inputs, p.size) for p in plans] == [
        ("photographs", inputs, (side, side)) for side in (256, 128) for inputs in (2, 3)
    ]
    (only,) = evaluation_plans([], 5, [], [], [])
    assert (only.kind, only.count, only.inputs, only.size) == ("generated", 5, 2, (128, 128))
    own_size = evaluation_plans([folder], 5, [3], [], [shipped_model()])
    assert [(p.kind, p.inputs, p.size) for p in own_size] == [
        ("photographs", 3, (256, 256)),
        ("generated", 3, (256, 256)),
    ]
    (wide,) = evaluation_plans([], 5, [], [Size.parse("256x336")], [])
    assert wide.size == (256, 336)
    everything = evaluation_plans([], None, [], [], [])
    assert [(p.size, p.count) for p in everything if p.kind == "generated"] == [((256, 256), 24), ((128, 128), 100)]
    small = evaluation_plans([], None, [], [Size.square(64)], [])[-1]
    assert (small.kind, small.size, small.count) == ("generated", (64, 64), 100)


def test_generated_scenes_are_those_of_their_seed_and_not_of_the_validation() -> None:
    assert GENERATED_SEED != VALIDATION_SEED
    first, second = (list(generated_cases(2, 2, 32, 48)) for _ in range(2))
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one.targets[0].image, other.targets[0].image)
        assert one.near == other.near
        assert one.inputs[0].image.shape == (3, 32, 48)
        # the inputs are what their photographs hold: 8 bits
        np.testing.assert_array_equal(np.rint(one.inputs[0].image * 255), one.photos[0].rgb.transpose(2, 0, 1))
        assert one.truth is not None
        assert one.truth.targets.shape == (2, 32, 48)
    assert not np.array_equal(first[0].targets[0].image, first[1].targets[0].image)
