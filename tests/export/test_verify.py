"""The verifier's own judgement: pictures, what is not finite, and what rounding in float32 excuses or does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import onnx
import pytest
import torch
from numpy.typing import NDArray
from spoiled import spoil

from gapmes.export import deviations as judging
from gapmes.export.cases import Case, sample_scene
from gapmes.export.compare import Deviation
from gapmes.export.graph import evaluated
from gapmes.export.report import CaseResult
from gapmes.export.tolerance import CEILINGS, CEILINGS_BELOW_TORCH, TOLERANCES, UNDETERMINED_CEILINGS, Tolerance
from gapmes.export.verify import verify
from gapmes.model.network import GaPMeS

FP32 = TOLERANCES["fp32"]


@pytest.fixture
def model(small_graph: onnx.ModelProto) -> onnx.ModelProto:
    """One that a test may change."""
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
    """Limits that no file keeps, so that torch in float64 has to tell."""
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


@pytest.mark.parametrize("spoiled", ["depth", "all routes", "most routes"])
def test_a_float64_that_tells_nothing_excuses_nothing(
    model: onnx.ModelProto, network: GaPMeS, sample: Case, monkeypatch: pytest.MonkeyPatch, spoiled: str
) -> None:
    """It is not finite, or most patches take another route there."""

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
    undetermined = FP32.for_undetermined_matching()
    for limits, ceilings in ((FP32, CEILINGS), (undetermined, UNDETERMINED_CEILINGS)):
        for what, ceiling in ceilings.items():
            assert limits.of_rounding(what, 0.1 * ceiling) == pytest.approx(0.1 * FP32.rounding_factor * ceiling)
            assert limits.of_rounding(what, 0.9 * ceiling) == ceiling
    for what, ceiling in CEILINGS_BELOW_TORCH.items():
        assert CEILINGS[what] < ceiling < UNDETERMINED_CEILINGS[what]
        assert FP32.of_rounding(what, np.inf) == ceiling
        assert undetermined.of_rounding(what, np.inf) == UNDETERMINED_CEILINGS[what]
    assert TOLERANCES["int8"].of_rounding("p99", 1.0) == 0


def test_where_matching_is_undetermined_torch_is_judged_by_inputs_nearby_too(
    model: onnx.ModelProto, network: GaPMeS, sample: Case
) -> None:
    """The largest of every number is at least that of the inputs alone, and the exported file's is its own."""
    alone = verified(model, network, sample, judged_by_rounding(1e9)).beside_float64
    beside = verified(model, network, replace(sample, undetermined=True), judged_by_rounding(1e9)).beside_float64
    assert set(alone) == set(beside)
    assert any(beside[name].torch.p99 > alone[name].torch.p99 for name in alone)
    for name, one in alone.items():
        assert beside[name].torch.p99 >= one.torch.p99
        assert beside[name].torch.p99 <= 10 * one.torch.p99  # found: 1.0 to 3
        assert beside[name].exported == one.exported


def test_neighbouring_inputs_differ_by_a_step_of_float32(sample: Case) -> None:
    near = list(judging._neighbours(sample.inputs))
    assert len(near) == judging.NEIGHBOURS
    for inputs in near:
        moved = (inputs.images - sample.inputs.images).abs()
        assert 0.5 < (moved > 0).float().mean() < 0.7
        assert moved.max() <= 2.0**-24
        assert inputs.images.min() >= 0
        assert inputs.images.max() <= 1


@pytest.mark.parametrize("share", [0.99, 1.01])
def test_above_the_ceiling_a_file_may_be_as_far_as_torch(
    model: onnx.ModelProto, network: GaPMeS, sample: Case, monkeypatch: pytest.MonkeyPatch, share: float
) -> None:
    """The mean of one output is beyond its limit and its ceiling; no farther from float64 than torch, it passes."""

    def distances(*_: object) -> dict[str, judging.BesideFloat64]:
        torchs = Deviation(0.1, 1e-5, 1.5 * CEILINGS["mean"], 0.0, 1.0, finite=True)
        return {"opacities": judging.BesideFloat64(replace(torchs, mean=share * torchs.mean), torchs)}

    monkeypatch.setattr("gapmes.export.verify.beside_float64", distances)
    found = {"opacities": Deviation(0.1, 1e-5, 1e-4, 0.0, 1.0, finite=True)}
    monkeypatch.setattr("gapmes.export.verify.deviations", lambda *_: found)
    failures = verified(model, network, sample, FP32).failures
    assert [failure for failure in failures if failure.startswith("opacities")] == failures
    assert len(failures) == (share > 1)


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
