"""The models that `gapmes evaluate` compares: files in several runtimes, and checkpoints exported for every size."""

from __future__ import annotations

import json
from importlib.metadata import PackageNotFoundError
from importlib.util import find_spec
from pathlib import Path

import onnx
import pytest
from evaluate_runs import refused, run

from gapmes.export.evaluation import models
from gapmes.export.evaluation.models import load_models
from gapmes.export.size import Size
from gapmes.service.errors import ModelError
from gapmes.service.network.backends import choice


@pytest.mark.skipif(find_spec("openvino") is None, reason="pip install 'gapmes[openvino]'")
def test_engines_side_by_side(small_graph: onnx.ModelProto, tmp_path: Path) -> None:
    """The same file in two runtimes: both are measured, and the report says which is which."""
    (tmp_path / "net.onnx").write_bytes(small_graph.SerializeToString())
    files, engines = ("--model", tmp_path / "net.onnx"), ("--engine", "onnxruntime", "--engine", "openvino-fp32")
    assert run("--generated", 1, *files, *engines, "--fade", 0, "--out", tmp_path / "out") == 0
    document = json.loads((tmp_path / "out" / "report.json").read_text())
    names = ["net, onnxruntime", "net, openvino-fp32"]
    assert [model["label"] for model in document["models"]] == names
    assert [model["engine"]["name"] for model in document["models"]] == ["onnxruntime", "openvino"]
    one, other = (document["groups"][0]["mean"][name]["all"]["psnr"] for name in names)
    assert one != other
    assert one == pytest.approx(other, abs=0.1)
    assert f"openvino {document['models'][1]['engine']['version']}, fp32" in (tmp_path / "out/report.md").read_text()


def test_every_file_in_every_engine(
    monkeypatch: pytest.MonkeyPatch, checkpoint: Path, small_graph: onnx.ModelProto, tmp_path: Path
) -> None:
    """Files first, then engines; a checkpoint keeps its name. OpenVINO's part is taken by onnxruntime here."""
    made = []

    class Pretended(models.RecordingEngine):
        def __init__(self, path: Path, *, threads: int | None, engine: str) -> None:
            made.append((path.name, engine))
            super().__init__(path, threads=threads)

    def exported(_source: Path, target: Path, **_: object) -> None:
        target.write_bytes(small_graph.SerializeToString())

    monkeypatch.setattr(models, "RecordingEngine", Pretended)
    monkeypatch.setattr(models, "export_checkpoint", exported)
    (tmp_path / "net.onnx").write_bytes(small_graph.SerializeToString())
    files = [tmp_path / "net.onnx", checkpoint]
    found = load_models(files, [Size.square(64)], tmp_path, engines=["onnxruntime", "openvino-bf16"], threads=1)
    assert [model.label for model in found] == [
        "net, onnxruntime",
        "net, openvino-bf16",
        "tiny, onnxruntime",
        "tiny, openvino-bf16",
    ]
    assert [model.file for model in found] == ["net.onnx"] * 2 + [checkpoint.name] * 2
    assert made == [(name, e) for name in ("net.onnx", "tiny-64.onnx") for e in ("onnxruntime", "openvino-bf16")]
    assert all(model.lambdas == found[0].lambdas is not None for model in found)
    (alone,) = load_models(files[:1], [Size.square(64)], tmp_path, engines=["openvino-fp32"], threads=1)
    assert alone.label == "net"


def test_wrong_engines_are_named_before_anything_is_loaded(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(name: str) -> str:
        raise PackageNotFoundError(name)

    arguments = ("--generated", 1, "--size", 256, "--model", tmp_path / "nowhere.safetensors", "--out", tmp_path)
    assert run(*arguments, "--engine", "tpu") == 1
    refused(capfd, "is no engine")
    assert run(*arguments, "--engine", "onnxruntime", "--engine", "onnxruntime") == 1
    refused(capfd, "the same engine twice")
    monkeypatch.setattr(choice, "version", missing)
    assert run(*arguments, "--engine", "openvino-fp32") == 1
    refused(capfd, "needs the package openvino")


def test_a_checkpoint_is_exported_for_every_size(
    monkeypatch: pytest.MonkeyPatch, checkpoint: Path, small_graph: onnx.ModelProto, tmp_path: Path
) -> None:
    exports = []

    def exported(source: Path, target: Path, *, height: int, width: int, **_: object) -> None:
        exports.append((source, height, width))
        target.write_bytes(small_graph.SerializeToString())

    monkeypatch.setattr(models, "export_checkpoint", exported)
    (model,) = load_models([checkpoint], [Size.square(64)], tmp_path, threads=1)
    assert exports == [(checkpoint, 64, 64)]
    assert model.size == (64, 64)
    assert model.lambdas is not None
    assert all(0 < value < 1 for value in model.lambdas.values())
    with pytest.raises(ModelError, match="twice"):
        load_models([checkpoint, checkpoint], [Size.square(64)], tmp_path)
