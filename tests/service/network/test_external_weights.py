"""External weights: the same network, identified by one hash, and refused if they are other weights."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path

import onnx
import pytest
from external_model import write_external
from test_engine import inputs
from test_prepared_model import mapped, outputs

from gapmes.service.errors import ModelError
from gapmes.service.network import model_file as module
from gapmes.service.network import prepared_model
from gapmes.service.network.engine import Engine
from gapmes.service.network.model_file import model_file
from gapmes.service.shipped import shipped_model


@pytest.fixture
def graph(tmp_path: Path, standin_model: Path) -> Path:
    """The stand-in with its tables outside."""
    write_external(standin_model, tmp_path / "outside.onnx")
    return tmp_path / "outside.onnx"


def test_it_is_the_same_network(graph: Path, engine: Engine) -> None:
    outside = Engine(graph, threads=1)
    for name, value in outside.run(**inputs(3)).items():
        assert value.tobytes() == engine.run(**inputs(3))[name].tobytes(), name


def test_the_sum_of_the_graph_names_the_weights_too(graph: Path) -> None:
    """The graph holds the sum of the weights: other weights are another graph."""
    file = model_file(graph)
    data = graph.with_name("outside.onnx.data")
    assert file.weights is not None
    assert file.weights.sha256 == hashlib.sha256(data.read_bytes()).hexdigest()
    assert file.weights.sha256.encode() in graph.read_bytes()
    assert file.info.file_sha256 == hashlib.sha256(graph.read_bytes()).hexdigest()
    assert file.bytes == graph.stat().st_size + data.stat().st_size


def test_missing_weights_are_named_with_what_to_do(graph: Path) -> None:
    data = graph.with_name("outside.onnx.data")
    expected = hashlib.sha256(data.read_bytes()).hexdigest()
    data.unlink()
    with pytest.raises(ModelError, match=r"outside\.onnx\.data with the weights .* No such file") as caught:
        Engine(graph)
    assert expected in caught.value.message
    assert "copy the outside.onnx.data beside it" in str(caught.value.cure)
    assert caught.value.field == "model"


def test_a_short_file_is_told_with_both_sizes(graph: Path) -> None:
    data = graph.with_name("outside.onnx.data")
    whole = data.read_bytes()
    data.write_bytes(whole[:-1])
    with pytest.raises(ModelError, match=f"has {len(whole) - 1} bytes, the graph needs {len(whole)}"):
        Engine(graph)


def test_other_weights_are_told_with_both_sums(graph: Path) -> None:
    data = graph.with_name("outside.onnx.data")
    before = data.read_bytes()
    data.write_bytes(bytes([before[0] ^ 1]) + before[1:])
    with pytest.raises(ModelError, match="has the sha256") as caught:
        Engine(graph)
    for content in (before, data.read_bytes()):
        assert hashlib.sha256(content).hexdigest() in caught.value.message
    assert str(data) in caught.value.message


def test_the_sum_is_taken_once_while_the_file_stays(graph: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Engine(graph)
    with monkeypatch.context() as patch:
        patch.setattr(module.hashlib, "file_digest", None)
        Engine(graph)
    copy = graph.with_name("copy.onnx.data")
    shutil.copy(graph.with_name("outside.onnx.data"), copy)
    copy.replace(graph.with_name("outside.onnx.data"))
    Engine(graph)


def test_weights_that_the_metadata_do_not_name_are_refused(tmp_path: Path, standin_model: Path) -> None:
    write_external(standin_model, tmp_path / "m.onnx", digest=False)
    with pytest.raises(ModelError, match=r"no metadata gapmes\.external_sha256") as caught:
        Engine(tmp_path / "m.onnx")
    assert "export it again" in str(caught.value.cure)


@pytest.mark.parametrize("location", ["../m.onnx.data", "/etc/passwd", "a/b", ".."])
def test_weights_in_another_folder_are_refused(tmp_path: Path, standin_model: Path, location: str) -> None:
    write_external(standin_model, tmp_path / "m.onnx", location=location)
    with pytest.raises(ModelError, match="need the name of a file beside it"):
        Engine(tmp_path / "m.onnx")


def test_weights_in_two_files_are_refused(graph: Path) -> None:
    model = onnx.load(graph, load_external_data=False)
    first = next(tensor for tensor in model.graph.initializer if tensor.external_data)
    second = model.graph.initializer.add()
    second.CopyFrom(first)
    next(entry for entry in second.external_data if entry.key == "location").value = "other"
    graph.write_bytes(model.SerializeToString())
    with pytest.raises(ModelError, match=r"weights in 2 files \(other, outside\.onnx\.data\), need one"):
        Engine(graph)


def test_prepared_it_has_the_same_bits_and_maps_its_weights(tmp_path: Path) -> None:
    write_external(shipped_model(), tmp_path / "tiny.onnx")
    expected = outputs(Engine(threads=1))
    for _ in range(2):
        engine = Engine(tmp_path / "tiny.onnx", threads=1, prepare=tmp_path / "prepared")
        [folder] = [path for path in (tmp_path / "prepared").iterdir() if path.is_dir()]
        assert mapped(folder / prepared_model.WEIGHTS)
        assert not mapped(tmp_path / "tiny.onnx.data")
        for name, value in outputs(engine).items():
            assert value.tobytes() == expected[name].tobytes(), name
