"""Export end to end: accepted files, rejected files, int8, and the shipped file, which the exporter reproduces."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import numpy_helper
from spoiled import spoil
from typer.testing import CliRunner

from gapmes.export import pipeline
from gapmes.export.cli import app
from gapmes.export.quantise import quantised
from gapmes.export.report import Report
from gapmes.export.samples import random_scene
from gapmes.model.checkpoint import load_checkpoint
from gapmes.model.weights_file import file_sha256
from gapmes.service.network.contract import INPUTS
from gapmes.service.process.machine import processor
from gapmes.service.shipped import shipped_model


@pytest.fixture
def prebuilt(monkeypatch: pytest.MonkeyPatch, small_graph: onnx.ModelProto) -> onnx.ModelProto:
    """A copy of the small graph that the pipeline uses instead of exporting again."""
    copy = onnx.ModelProto()
    copy.CopyFrom(small_graph)
    monkeypatch.setattr(pipeline, "export_graph", lambda *_: copy)
    return copy


def test_accepted_file_carries_its_measured_tolerance(
    prebuilt: onnx.ModelProto, checkpoint: Path, tmp_path: Path
) -> None:
    events = []
    out = tmp_path / "net.onnx"
    result = pipeline.export_checkpoint(checkpoint, out, height=64, width=64, quick=True, listener=events.append)
    assert result.report.passed
    assert sorted(p.name for p in tmp_path.iterdir()) == ["net.onnx", "net.report.json"]
    metadata = {p.key: p.value for p in onnx.load(out).metadata_props}
    assert json.loads(metadata["gapmes.tolerance"]) == result.report.worst()
    assert Report.read(result.report_path).model_sha256 == file_sha256(out)
    verifying = [e for e in events if e.name == "verify" and e.total > 1]
    assert verifying[-1].done == verifying[-1].total == len(result.report.cases)
    kinds = {(case.name, case.gates) for case in result.report.cases}
    assert {("sample", "as trained"), ("grey", "as trained"), ("random", "all tied"), ("random", "one expert")} <= kinds


def test_a_file_beyond_tolerance_is_rejected_and_kept_apart(
    prebuilt: onnx.ModelProto, checkpoint: Path, tmp_path: Path
) -> None:
    spoil(prebuilt)
    out = tmp_path / "net.onnx"
    out.write_bytes(b"what was there before")
    arguments = ["--checkpoint", str(checkpoint), "--size", "64x64", "--quick", "-o", str(out), "--json"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 3
    assert "opacities" in result.output
    assert out.read_bytes() == b"what was there before"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["net.onnx", "net.rejected.onnx", "net.rejected.report.json"]
    answer = json.loads(result.stdout)["error"]
    assert answer["rejected"] == str(tmp_path / "net.rejected.onnx")
    assert any("opacities" in failure for failure in answer["failures"])
    report = Report.read(tmp_path / "net.rejected.report.json")
    assert not report.passed
    named = {failure.split(":")[0] for case in report.cases for failure in case.failures}
    assert "opacities" in named
    assert named <= {"opacities", "picture", "picture without jumps"}


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (["--size", "100x64"], 1, "multiple of 16"),
        (["--size", "big"], 2, "HEIGHTxWIDTH"),
        (["--size", "\uff12\uff15\uff16"], 2, "HEIGHTxWIDTH"),
        (["--size", "16x64"], 2, "--size: is 16x64 px, need 32 or more"),
        (["--size", "100000"], 2, "--size: is 100000 px, need 4096 or less"),
        (["--size", "9" * 5000], 2, "HEIGHTxWIDTH"),  # more digits than Python converts
        (["--preset", "huge"], 2, "tiny, small, base"),
        (["--precision", "fp4"], 2, "fp32, int8"),
        (["--preset", "base"], 1, "no weights are shipped"),
        (["--checkpoint", "nowhere.safetensors"], 1, "nowhere.safetensors: no such file"),
        (["--scale-max", "0.1"], 2, "goes with --architecture depthsplat"),
        (["--architecture", "depthsplat", "--checkpoint", "x.pth", "--scale-max", "0"], 2, "need a length above 0"),
        (["--architecture", "depthsplat", "--checkpoint", "x.pth", "--scale-max", "nan"], 2, "need a length above 0"),
        (
            ["--architecture", "depthsplat", "--checkpoint", "x.pth", "--scale-max", "1e-11"],
            2,
            "of 1e-10 to 1e+06 units",
        ),
        (
            ["--architecture", "depthsplat", "--checkpoint", "x.pth", "--scale-max", "1e39"],
            2,
            "of 1e-10 to 1e+06 units",
        ),
        (["--checkpoint", str(Path(__file__))], 1, "cannot be read as safetensors"),
    ],
)
def test_wrong_arguments_are_named(arguments: list[str], code: int, text: str, tmp_path: Path) -> None:
    result = CliRunner().invoke(app, [*arguments, "-o", str(tmp_path / "x.onnx")], env={"COLUMNS": "200"})
    assert result.exit_code == code
    assert text in result.output
    assert list(tmp_path.iterdir()) == []


@pytest.mark.case("B2")
def test_int8_keeps_gates_in_float32_and_passes(prebuilt: onnx.ModelProto, checkpoint: Path, tmp_path: Path) -> None:
    """There is no float16 export; int8 is verified on the exporting processor, also on extreme pictures."""
    out = tmp_path / "int8.onnx"
    result = pipeline.export_checkpoint(checkpoint, out, height=64, width=64, precision="int8", quick=True)
    model = onnx.load(out)
    operators = [node.op_type for node in model.graph.node]
    assert operators.count("MatMulInteger") > 20
    float32 = {i.name for i in model.graph.initializer if i.data_type == onnx.TensorProto.FLOAT}
    for gate in ("expert_gate", "task_gate"):
        assert any(name.startswith(f"network.mixture.gates.{gate}.weight") for name in float32)
    assert len(out.read_bytes()) < 0.85 * len(prebuilt.SerializeToString())
    name, flags = processor()
    assert result.report.versions["processor"] == ", ".join([name, *flags])  # instruction sets round differently
    flips = sum(case.routes.flipped for case in result.report.cases if case.routes)
    patches = sum(case.routes.patches for case in result.report.cases if case.routes)
    assert flips <= 0.02 * patches


def test_quantising_a_graph_without_linear_layers_is_refused() -> None:
    info = onnx.helper.make_tensor_value_info("x", onnx.TensorProto.FLOAT, [1])
    out = onnx.helper.make_tensor_value_info("y", onnx.TensorProto.FLOAT, [1])
    graph = onnx.helper.make_graph([onnx.helper.make_node("Relu", ["x"], ["y"])], "g", [info], [out])
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 20)])
    with pytest.raises(ValueError, match="no linear layer"):
        quantised(model)


def test_shipped_file_is_what_the_exporter_makes_of_the_shipped_checkpoint(checkpoint: Path) -> None:
    shipped = onnx.load(shipped_model())
    metadata = {p.key: p.value for p in shipped.metadata_props}
    assert metadata["gapmes.weights_sha256"] == file_sha256(checkpoint)
    assert set(json.loads(metadata["gapmes.tolerance"])) >= {"means", "depth", "expert_weight"}
    height, width = int(metadata["gapmes.height"]), int(metadata["gapmes.width"])
    again = pipeline.export_graph(load_checkpoint(checkpoint), height, width)
    ours, theirs = ({i.name: numpy_helper.to_array(i) for i in model.graph.initializer} for model in (again, shipped))
    assert ours.keys() == theirs.keys()
    assert all(np.array_equal(ours[name], theirs[name]) for name in ours)
    assert [n.op_type for n in again.graph.node] == [n.op_type for n in shipped.graph.node]
    inputs = random_scene(2, height, width, seed=9)
    feed = {name: value.numpy() for name, value in zip(INPUTS, inputs.tensors(), strict=True)}
    results = []
    for model in (again, shipped):
        session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
        results.append(session.run(None, feed))
    assert all(np.array_equal(a, b) for a, b in zip(*results, strict=True))
