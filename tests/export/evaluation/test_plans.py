"""The plans of `gapmes evaluate`: sizes, views and counts, and the generated scenes of a seed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gapmes.export.evaluation.case import GENERATED_SEED, generated_cases
from gapmes.export.evaluation.plans import evaluation_plans, outlook
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


def test_what_is_about_to_be_done_is_told() -> None:
    told = outlook(evaluation_plans([sample_folder()], 24, [2], [Size.square(256), Size.square(128)], []), [], 1)
    scenes = ("1 scene of 256", "1 scene of 128", "24 scenes of 256", "24 scenes of 128")
    kinds = ("photographs", "photographs", "generated", "generated")
    groups = ", ".join(f"{some} px from 2 views ({kind})" for some, kind in zip(scenes, kinds, strict=True))
    export = "exports and verifies tiny.safetensors for 128 px first"
    assert told == f"measures {groups}; {export}: about 14 min of processor time"
    plain = evaluation_plans([], 5, [], [Size.square(256)], [])
    assert outlook(plain, [], 1).endswith("5 scenes of 256 px from 2 views (generated): about 2 min of processor time")
    four = evaluation_plans([], 5, [4], [Size.square(256)], [])
    assert outlook(four, [], 1).endswith("from 4 views (generated): about 8 min of processor time")
    twice = outlook(plain, [Path("a.onnx"), Path("b.safetensors")], 2)
    assert twice.endswith("; exports and verifies b.safetensors for 256 px first: about 7 min of processor time")


def test_generated_scenes_are_those_of_their_seed_and_not_of_the_validation() -> None:
    assert GENERATED_SEED != VALIDATION_SEED
    first, second = (list(generated_cases(2, 3, 32, 48)) for _ in range(2))
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one.targets[0].image, other.targets[0].image)
        assert one.near == other.near
        assert one.inputs[0].image.shape == (3, 32, 48)
        # the inputs are what their photographs hold: 8 bits
        np.testing.assert_array_equal(np.rint(one.inputs[0].image * 255), one.photos[0].rgb.transpose(2, 0, 1))
        assert one.truth is not None
        assert (one.truth.inputs.shape, one.truth.targets.shape) == ((3, 32, 48), (2, 32, 48))
        behind = np.isinf(one.truth.inputs)
        assert np.all(one.truth.input_surfaces()[behind] == np.float32(one.truth.far))
        np.testing.assert_array_equal(one.truth.input_surfaces()[~behind], one.truth.inputs[~behind])
    assert not np.array_equal(first[0].targets[0].image, first[1].targets[0].image)
