"""The full trunk and DepthSplat export in the same way: shapes and values at every number of views, external weights,
int8, and DepthSplat's own file."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
from few_blocks import little_full_network
from full_networks import VIT
from miniature_depthsplat import miniature_depthsplat

from gapmes.export.build import export_graph
from gapmes.export.cases import Case
from gapmes.export.metadata import add_metadata, contract_metadata
from gapmes.export.model_file import data_files, remove_model, write_model
from gapmes.export.quantise import quantised
from gapmes.export.samples import hostile_scenes, lenses_scene, random_scene
from gapmes.export.tolerance import TOLERANCES
from gapmes.export.verification import verify
from gapmes.model.architectures import Network, config_from_json
from gapmes.model.depthsplat.config import Compatibility
from gapmes.model.depthsplat.network import DepthSplat
from gapmes.service.network.contract import INPUTS, REQUIRED_OUTPUTS
from gapmes.service.network.engine import Engine

SIZE, OBLONG = 64, (48, 80)  # px: of a side, and height and width
VIEWS = (2, 3, 4, 6)


def cases(height: int, width: int) -> list[Case]:
    made = [Case("random", "as trained", random_scene(views, height, width, seed=views)) for views in VIEWS]
    half = Case("half masked", "as trained", hostile_scenes(2, height, width)["half masked"])
    return [*made, half, Case("lenses", "as trained", lenses_scene(3, height, width, seed=23))]


def check(model: onnx.ModelProto, network: Network, height: int = SIZE, width: int = SIZE) -> None:
    results = verify(model, network, cases(height, width), TOLERANCES["fp32"])
    assert [failure for result in results for failure in result.failures] == []
    assert len(results) == len(VIEWS) + 2


@pytest.fixture(scope="module")
def depthsplat() -> DepthSplat:
    return miniature_depthsplat(2, 4)


def test_depthsplat_exports_with_a_number_of_views_that_is_not_baked_in(
    depthsplat: DepthSplat, depthsplat_graph: onnx.ModelProto
) -> None:
    assert tuple(output.name for output in depthsplat_graph.graph.output) == REQUIRED_OUTPUTS
    check(depthsplat_graph, depthsplat)


def test_depthsplat_that_matches_at_an_eighth_exports_too_with_every_switch_of_compatibility() -> None:
    network = miniature_depthsplat(2, 8, Compatibility.authors())
    check(export_graph(network, SIZE, SIZE), network)
    with pytest.raises(ValueError, match="height is 80 px, need a multiple of 32 of at least 32"):
        export_graph(network, 80, 64)


def test_a_full_network_exports_with_a_number_of_views_that_is_not_baked_in(miniature_graph: onnx.ModelProto) -> None:
    check(miniature_graph, little_full_network(), *OBLONG)


def test_large_weights_lie_beside_the_graph_and_the_engine_reads_them(
    depthsplat: DepthSplat, depthsplat_graph: onnx.ModelProto, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gapmes.export.model_file.EXTERNAL_BYTES", 2**20)
    metadata = contract_metadata(
        depthsplat, height=SIZE, width=SIZE, weights_sha256="0" * 64, licence="MIT", precision="fp32"
    )
    graph = onnx.ModelProto()
    graph.CopyFrom(depthsplat_graph)
    add_metadata(graph, metadata)
    path = tmp_path / "model.onnx"
    write_model(graph, path)
    written = onnx.load(path, load_external_data=False)
    digest = {p.key: p.value for p in written.metadata_props}["gapmes.external_sha256"]
    (data,) = data_files(path)
    assert hashlib.sha256(data.read_bytes()).hexdigest() == digest
    assert path.stat().st_size < 2**20 < data.stat().st_size
    assert all(tensor.raw_data for tensor in graph.graph.initializer if np.prod(tensor.dims))  # ours is left whole
    arrays = [value.numpy() for value in random_scene(2, SIZE, SIZE, seed=2).tensors()]
    inside = onnxruntime.InferenceSession(graph.SerializeToString(), providers=["CPUExecutionProvider"])
    expected = inside.run(list(REQUIRED_OUTPUTS), dict(zip(INPUTS, arrays, strict=True)))
    engine = Engine(path, threads=2)
    found = engine.run(*arrays)
    for name, value in zip(REQUIRED_OUTPUTS, expected, strict=True):
        np.testing.assert_allclose(found[name], value, rtol=1e-4, atol=1e-4, err_msg=name)
    assert config_from_json(depthsplat.config.to_json()) == depthsplat.config
    assert "expert_index" not in found
    remove_model(path)
    assert not list(tmp_path.iterdir())


def test_a_model_that_shrank_leaves_no_weights_behind(depthsplat_graph: onnx.ModelProto, tmp_path: Path) -> None:
    path = tmp_path / "model.onnx"
    (tmp_path / "model.onnx.0123456789ab.data").write_bytes(b"of an older file")
    write_model(depthsplat_graph, path)
    assert [file.name for file in tmp_path.iterdir()] == ["model.onnx"]


def test_a_write_that_fails_at_the_end_leaves_the_model_before_with_its_weights(
    depthsplat_graph: onnx.ModelProto, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gapmes.export.model_file.EXTERNAL_BYTES", 2**20)
    path = tmp_path / "model.onnx"
    write_model(depthsplat_graph, path)
    before = {file: file.read_bytes() for file in [path, *data_files(path)]}
    other = onnx.ModelProto()
    other.CopyFrom(depthsplat_graph)
    large = max(other.graph.initializer, key=lambda tensor: len(tensor.raw_data))
    large.raw_data = bytes(len(large.raw_data))
    replace = Path.replace

    def fails(self: Path, target: Path) -> Path:
        if target == path:
            raise OSError("no space left")
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", fails)
    with pytest.raises(OSError, match="no space left"):
        write_model(other, path)
    assert all(file.read_bytes() == content for file, content in before.items())


def test_int8_leaves_the_matched_features_in_float32(depthsplat: DepthSplat, depthsplat_graph: onnx.ModelProto) -> None:
    small = quantised(depthsplat_graph)
    integer = [node.name for node in small.graph.node if node.op_type == "MatMulInteger"]
    linear = 6 * VIT.layers  # query, key, value, output and two of the MLP
    assert len(integer) == linear
    assert all("pretrained.vit.encoder" in name for name in integer)
    floats = [n for n in small.graph.node if n.op_type == "MatMul" and "transformer.layers" in n.name]
    assert floats
    scene = random_scene(2, SIZE, SIZE, seed=2)
    results = verify(small, depthsplat, [Case("random", "as trained", scene)], TOLERANCES["int8"])
    assert results[0].failures == []
    assert results[0].outputs["depth"].maximum > 1e-5  # it is not the float32 graph
