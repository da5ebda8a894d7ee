"""What the verification's cases see: files that take another lens or another mask than that of each view fail."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import onnx
import pytest
from spoiled import spoil_lens, spoil_views

from gapmes.export.cases import verification_cases
from gapmes.export.tolerance import TOLERANCES
from gapmes.export.verification import verify
from gapmes.model.network import GaPMeS

FX, CX, FY, CY, ONE = 0, 2, 4, 5, 8  # of a flattened intrinsic matrix


@pytest.mark.parametrize(
    ("spoil", "agrees"),
    [
        (lambda _: None, True),
        (partial(spoil_lens, entry=CX, taken_from=ONE, share=0.5), False),
        (partial(spoil_lens, entry=CY, taken_from=ONE, share=0.5), False),
        (partial(spoil_lens, entry=FY, taken_from=FX, share=1.0), False),
        (partial(spoil_views, name="intrinsics"), False),
        (partial(spoil_views, name="patch_mask"), False),
    ],
    ids=["as it is", "central column", "central row", "square pixels", "first lens", "first mask"],
)
def test_each_view_has_its_own_lens_and_mask(
    spoil: Callable[[onnx.ModelProto], None], agrees: bool, small_graph: onnx.ModelProto, network: GaPMeS
) -> None:
    """No case of square pictures through one centred lens would tell these from torch."""
    model = onnx.ModelProto()
    model.CopyFrom(small_graph)
    spoil(model)
    cases = [case for case in verification_cases(64, 64, quick=True) if case.name == "lenses"]
    results = verify(model, network, cases, TOLERANCES["fp32"])
    assert results
    assert all(not result.failures for result in results) == agrees
