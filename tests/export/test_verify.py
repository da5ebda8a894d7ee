"""The verifier's judgement: pictures, non-finite values, and differences that float32 rounding excuses or does not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import onnx
import pytest
import torch
from numpy.typing import NDArray
from spoiled import spoil, spoil_ties

from gapmes.export import deviations as judging
from gapmes.export import verification as verifying
from gapmes.export.cases import Case, sample_scene
from gapmes.export.gate_settings import GateSetting, gate_values, with_gates
from gapmes.export.graph import evaluated
from gapmes.export.report import CaseResult
from gapmes.export.samples import random_scene
from gapmes.export.tolerance import CEILINGS, TOLERANCES, UNDETERMINED_CEILINGS, Tolerance
from gapmes.export.verification import verify
from gapmes.model.network import GaPMeS

FP32 = TOLERANCES["fp32"]


@pytest.fixture
def model(small_graph: onnx.ModelProto) -> onnx.ModelProto:
    """A model that a test may change."""
    copied = onnx.ModelProto()
    copied.CopyFrom(small_graph)
    return copied


@pytest.fixture(scope="module")
def sample() -> Case:
    return Case("sample", "as trained", sample_scene(2, 64, 64))


def verified(model: onnx.ModelProto, network: GaPMeS, case: Case, tolerance: Tolerance) -> CaseResult:
    (result,) = verify(model, network, [case], tolerance)
    return result


def failed(result: CaseResult) -> set[str]:
    return {failure.split(":")[0] for failure in result.failures}


def judged_by_rounding(factor: float | None) -> Tolerance:
    """Limits that no file meets, so that torch in float64 has to decide."""
    return replace(FP32, p99=1e-12, mean=1e-12, rounding_factor=factor)


def test_the_sample_case_compares_pictures(model: onnx.ModelProto, network: GaPMeS, sample: Case) -> None:
    result = verified(model, network, sample, FP32)
    assert not result.failures
    assert result.picture is not None
    never = replace(FP32, picture_psnr=101, smooth_picture_psnr=101)
    assert failed(verified(model, network, sample, never)) == {"picture", "picture without jumps"}


def test_what_is_not_finite_fails_and_is_not_drawn(model: onnx.ModelProto, network: GaPMeS, sample: Case) -> None:
    spoil(model, np.nan)
    result = verified(model, network, sample, FP32)
    assert "opacities: not finite" in result.failures
    assert result.picture is None
    assert result.beside_float64 == {}


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda value: value.astype(np.float64), "depth: is float64 (2, 64, 64), need float32 (2, 64, 64)"),
        (lambda value: value[..., None], "depth: is float32 (2, 64, 64, 1), need float32 (2, 64, 64)"),
    ],
)
def test_other_types_and_shapes_fail(
    change: Callable[[NDArray], NDArray],
    told: str,
    model: onnx.ModelProto,
    network: GaPMeS,
    sample: Case,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    real = verifying._of_file

    def spoiled(*given: Any) -> Any:
        found = real(*given)
        return found | {"depth": change(found["depth"])}

    monkeypatch.setattr(verifying, "_of_file", spoiled)
    assert verified(model, network, sample, FP32).failures == [told]


@pytest.mark.parametrize(
    ("weight", "layer"),
    [
        ("trunk.to_half.weight", "trunk.at_half.norm"),  # torch cannot go on
        ("semantic.vit.encoder.layer.0.norm2.weight", "semantic.vit.encoder.layer.1.norm1"),  # it can
    ],
)
def test_where_torch_overflows_the_layer_is_named(
    weight: str, layer: str, model: onnx.ModelProto, network: GaPMeS, sample: Case
) -> None:
    network.get_parameter(weight).data.view(-1)[0] = 1e38
    (failure,) = verified(model, network, sample, FP32).failures
    assert failure.startswith(f"torch: layer {layer} overflows: ")
    assert failure.endswith(f"the largest weight is 1e+38, in {weight}")


def test_what_rounding_explains_passes(model: onnx.ModelProto, network: GaPMeS, sample: Case) -> None:
    result = verified(model, network, sample, judged_by_rounding(20))
    assert result.failures == []
    assert set(result.beside_float64) >= {"means", "depth", "opacities"}
    for name, found in result.beside_float64.items():
        assert 0 < found.torch.mean < 1e-5, name  # float32 is not float64, and near to it
        assert found.exported != found.torch
    refused = verified(model, network, sample, judged_by_rounding(0.01)).failures
    assert any("beside float64" in failure for failure in refused)
    alone = verified(model, network, sample, judged_by_rounding(None))
    assert alone.beside_float64 == {}
    assert failed(alone) == set(result.beside_float64)


@pytest.mark.parametrize("tolerance", [FP32, judged_by_rounding(20)])
def test_a_small_error_is_no_rounding(
    model: onnx.ModelProto, network: GaPMeS, sample: Case, tolerance: Tolerance
) -> None:
    """1e-3 on a logit: at most 2.5e-4 of an opacity."""
    spoil(model, 1e-3)
    result = verified(model, network, sample, tolerance)
    assert any(failure.startswith("opacities: p99") and "beside float64" in failure for failure in result.failures)
    found = result.beside_float64["opacities"]
    assert found.exported.p99 > 10 * found.torch.p99


@pytest.mark.parametrize("gates", ["all tied", "one expert", "two experts"])
def test_ties_that_go_to_another_index_fail(model: onnx.ModelProto, network: GaPMeS, gates: GateSetting) -> None:
    """Gates that were set leave nothing to rounding; trained gates have no ties, and the file is as good as any."""
    spoil_ties(model)
    scene = random_scene(2, 64, 64, seed=12)
    spoiled = verified(model, network, Case("random", gates, scene), TOLERANCES["int8"])
    assert "routes: 32 of 32 differ, 0 allowed" in spoiled.failures
    assert verified(model, network, Case("random", "as trained", scene), FP32).failures == []


@pytest.mark.parametrize("left", [0.49, 0.5])
def test_where_most_is_excused_nothing_passes(
    model: onnx.ModelProto, network: GaPMeS, sample: Case, monkeypatch: pytest.MonkeyPatch, left: float
) -> None:
    monkeypatch.setattr(verifying, "share_left", lambda *_: left)
    failures = verified(model, network, sample, FP32).failures
    assert failures == (["routes: only 49% of the values are left to compare, need 50%"] if left < 0.5 else [])


def test_routes_that_rounding_may_decide_excuse_no_empty_comparison(
    model: onnx.ModelProto, network: GaPMeS, sample: Case
) -> None:
    """Every logit lies within rounding of the next, and ties go to the highest index."""
    values = gate_values(network, "all tied")
    spoil_ties(model)
    network.load_state_dict(values, strict=False)
    result = verified(with_gates(model, values), network, sample, FP32)
    assert result.routes is not None
    assert (result.routes.flipped, result.routes.flipped_unambiguous) == (32, 0)
    assert result.failures == ["routes: only 0% of the values are left to compare, need 50%"]


@pytest.mark.parametrize("spoiled", ["depth", "all routes", "most routes"])
def test_a_float64_that_tells_nothing_excuses_nothing(
    model: onnx.ModelProto, network: GaPMeS, sample: Case, monkeypatch: pytest.MonkeyPatch, spoiled: str
) -> None:
    """It is not finite, or most patches take another route in it."""

    def useless(of: GaPMeS, inputs, dtype: torch.dtype) -> dict[str, NDArray[np.generic]]:
        found = evaluated(of, inputs, dtype)
        if spoiled == "depth":
            return found | {"depth": found["depth"] * np.nan}
        index = found["expert_index"] + 1
        if spoiled == "most routes":
            index[:, 0] -= 1
        return found | {"expert_index": index}

    monkeypatch.setattr(judging, "evaluated", useless)
    result = verified(model, network, sample, judged_by_rounding(1e9))
    assert failed(result) == ({"depth"} if spoiled == "depth" else set(result.beside_float64))
    assert "depth" in result.beside_float64


def test_rounding_has_a_ceiling() -> None:
    assert FP32.rounding_factor is not None
    for limits, ceilings in ((FP32, CEILINGS), (FP32.for_undetermined_matching(), UNDETERMINED_CEILINGS)):
        for what, ceiling in ceilings.items():
            assert limits.of_rounding(what, 0.1 * ceiling) == pytest.approx(0.1 * FP32.rounding_factor * ceiling)
            assert limits.of_rounding(what, np.inf) == ceiling
    assert all(CEILINGS[what] <= 0.05 * wide for what, wide in UNDETERMINED_CEILINGS.items())
    assert TOLERANCES["int8"].of_rounding("p99", 1.0) == 0


def test_the_network_is_left_in_float32(
    model: onnx.ModelProto, network: GaPMeS, sample: Case, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = {name: value.clone() for name, value in network.state_dict().items()}

    def unchanged() -> bool:
        after = network.state_dict()
        return all(v.dtype == after[name].dtype and torch.equal(v, after[name]) for name, v in before.items())

    def interrupted(of: GaPMeS, *_: object) -> dict[str, NDArray[np.generic]]:
        of.double()
        raise KeyboardInterrupt

    assert verified(model, network, sample, judged_by_rounding(20)).beside_float64
    assert unchanged()
    monkeypatch.setattr(judging, "evaluated", interrupted)
    with pytest.raises(KeyboardInterrupt):
        judging.beside_float64({}, {}, network, sample)
    assert unchanged()
