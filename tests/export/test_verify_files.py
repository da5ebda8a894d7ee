"""Verification as a separate command: files that do not belong together are refused in one line."""

from __future__ import annotations

import json
from pathlib import Path

import onnx
import pytest

from gapmes.export import verify as verify_module
from gapmes.export.metadata import OPSET, add_metadata
from gapmes.export.verify import main
from gapmes.model.checkpoint import shipped_checkpoint
from gapmes.service.shipped import shipped_model


def refused(model: Path, checkpoint: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """The message of the refusal; nothing is written."""
    report = model.with_name("report.json")
    assert main([str(model), "--checkpoint", str(checkpoint), "--report", str(report)]) == 1
    assert not report.exists()
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.startswith("refused: ")
    assert told.err.count("\n") == 1
    return told.err


def test_what_is_no_model_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = tmp_path / "text.onnx"
    text.write_text("text")
    checkpoint = shipped_checkpoint("tiny")
    assert "none.onnx cannot be read: No such file" in refused(tmp_path / "none.onnx", checkpoint, capsys)
    assert "text.onnx cannot be loaded, it is no ONNX file" in refused(text, checkpoint, capsys)


def test_another_checkpoint_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model, other = tmp_path / "tiny.onnx", tmp_path / "other.safetensors"
    model.write_bytes(shipped_model().read_bytes())
    other.write_bytes(b"other")
    assert "tiny.onnx was made from" in refused(model, other, capsys)
    assert "none.safetensors" in refused(model, tmp_path / "none.safetensors", capsys)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [("precision", "fp99", "gapmes.precision is 'fp99', need fp32 or int8"), ("config", "{}", "cannot build")],
)
def test_metadata_that_say_nothing_are_named(
    key: str, value: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = onnx.load(shipped_model())
    add_metadata(model, {key: value})
    onnx.save(model, tmp_path / "odd.onnx")
    assert said in refused(tmp_path / "odd.onnx", shipped_checkpoint("tiny"), capsys)


@pytest.mark.parametrize(
    ("name", "value"), [("depth_planes", 8), ("preset", "base"), ("backing", False), ("sh_degree", 3)]
)
def test_a_configuration_that_is_not_the_checkpoint_s_is_named(
    name: str, value: object, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The service takes it at its word, for example for the step of the depths."""
    model = onnx.load(shipped_model())
    config = json.loads(next(entry.value for entry in model.metadata_props if entry.key == "gapmes.config"))
    assert config[name] != value
    add_metadata(model, {"config": json.dumps({**config, name: value})})
    onnx.save(model, tmp_path / "odd.onnx")
    told = refused(tmp_path / "odd.onnx", shipped_checkpoint("tiny"), capsys)
    assert f"gapmes.config has {name} {value!r}, {shipped_checkpoint('tiny')} has {config[name]!r}" in told


def test_another_opset_than_the_graph_s_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = onnx.load(shipped_model())
    add_metadata(model, {"opset": "99"})
    onnx.save(model, tmp_path / "odd.onnx")
    told = refused(tmp_path / "odd.onnx", shipped_checkpoint("tiny"), capsys)
    assert f"gapmes.opset is 99, the graph has [{OPSET}]" in told


def test_a_graph_that_onnxruntime_cannot_load_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = onnx.load(shipped_model())
    model.graph.node[0].domain = "nowhere"
    onnx.save(model, tmp_path / "odd.onnx")
    told = refused(tmp_path / "odd.onnx", shipped_checkpoint("tiny"), capsys)
    assert "onnxruntime cannot load the graph: " in told


def test_a_graph_without_an_output_that_torch_has_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = onnx.load(shipped_model())
    model.graph.output.remove(next(output for output in model.graph.output if output.name == "route_margin"))
    onnx.save(model, tmp_path / "less.onnx")
    told = refused(tmp_path / "less.onnx", shipped_checkpoint("tiny"), capsys)
    assert "onnxruntime cannot run the graph: " in told
    assert "route_margin" in told


def test_where_no_report_can_be_written_nothing_is_computed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(verify_module, "verify", None)
    options = ["--checkpoint", str(shipped_checkpoint("tiny")), "--report", str(tmp_path / "none" / "report.json")]
    assert main([str(shipped_model()), *options]) == 1
    assert capsys.readouterr().err == f"refused: report: {tmp_path / 'none'} is not a folder (make it first)\n"
