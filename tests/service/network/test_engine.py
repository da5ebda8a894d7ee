"""The engine: what it refuses to load and to run, and equal bits from equal inputs."""

import hashlib
import json
import os
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper
from standin_model import COLUMNS, EXTRA, HEIGHT, METADATA, ROWS, WIDTH, write_standin

from gapmes.service.errors import MORE_MEMORY, ModelError
from gapmes.service.network.contract import OPTIONAL_OUTPUTS, REQUIRED_OUTPUTS
from gapmes.service.network.engine import Engine
from gapmes.service.process.threads import available_threads
from gapmes.service.shipped import shipped_model

OUTPUTS = REQUIRED_OUTPUTS + OPTIONAL_OUTPUTS
needs_openvino = pytest.mark.skipif(find_spec("openvino") is None, reason="pip install 'gapmes[openvino]'")


def inputs(views=2, seed=0):
    rng = np.random.default_rng(seed)
    poses = np.tile(np.eye(4, dtype=np.float32), (views, 1, 1))
    poses[:, 0, 3] = 0.1 * np.arange(views)
    return {
        "images": rng.random((views, 3, HEIGHT, WIDTH), dtype=np.float32),
        "intrinsics": np.tile(np.array([[1, 0, 0.5], [0, 1.3, 0.5], [0, 0, 1]], np.float32), (views, 1, 1)),
        "world_from_cam": poses,
        "near_far": np.array([1, 9], np.float32),
        "patch_mask": np.ones((views, ROWS * COLUMNS), bool),
    }


@pytest.mark.parametrize("views", [2, 3, 4, 6])
def test_shapes_follow_the_number_of_views(engine, views):
    outputs = engine.run(**inputs(views))
    count = views * (HEIGHT * WIDTH + EXTRA)
    assert set(outputs) == set(OUTPUTS)
    assert outputs["means"].shape == (count, 3)
    assert outputs["harmonics"].shape == (count, 4, 3)
    assert outputs["expert_index"].dtype == np.int64
    np.testing.assert_allclose(outputs["depth"], 3.0, rtol=1e-6)


def test_info_is_what_the_file_says(engine, standin_model):
    info = engine.info
    assert (info.preset, info.height, info.width, info.patch, info.patches) == ("standin", HEIGHT, WIDTH, 16, 12)
    assert info.config == {"sh_degree": 1}
    assert info.file_sha256 == hashlib.sha256(standin_model.read_bytes()).hexdigest()


def test_same_input_gives_same_bits(engine, standin_model):
    again = Engine(standin_model, threads=1)
    first = engine.run(**inputs(3))
    for other in (engine.run(**inputs(3)), again.run(**inputs(3))):
        for name in OUTPUTS:
            np.testing.assert_array_equal(first[name], other[name])


def test_telemetry_is_off_and_threads_are_explicit(engine, standin_model):
    assert os.environ["ORT_DISABLE_TELEMETRY"] == "1"
    assert engine.threads == 1
    options = engine._session.native.get_session_options()
    assert (options.intra_op_num_threads, options.inter_op_num_threads) == (1, 1)
    assert Engine(standin_model).threads == available_threads()
    with pytest.raises(ModelError, match="threads = 0"):
        Engine(standin_model, threads=0)


def test_the_default_thread_count_needs_no_cpu_affinity(standin_model, monkeypatch):
    """macOS has no `sched_getaffinity`."""
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    assert Engine(standin_model).threads == os.cpu_count()


@pytest.mark.parametrize(
    "name", ["openvino-fp16", "onnxruntime-x", "openvino", "openvino_fp32", "x", None, 3, b"onnxruntime"]
)
def test_an_engine_that_is_none_is_refused(standin_model, name):
    """Its results would tell of another precision than they have."""
    with pytest.raises(ModelError, match="is no engine") as caught:
        Engine(standin_model, threads=1, engine=name)
    assert caught.value.field == "engine"


def test_missing_file_is_named(tmp_path):
    with pytest.raises(ModelError, match=r"nothing\.onnx cannot be read: No such file") as caught:
        Engine(tmp_path / "nothing.onnx")
    assert "gapmes-export" in caught.value.cure


def test_a_file_that_is_no_onnx(tmp_path):
    path = tmp_path / "text.onnx"
    path.write_text("hello")
    with pytest.raises(ModelError, match="cannot be loaded, it is no ONNX file"):
        Engine(path)


def test_an_onnx_file_of_somebody_else(tmp_path):
    value = helper.make_tensor_value_info("x", TensorProto.FLOAT, [1])
    out = helper.make_tensor_value_info("y", TensorProto.FLOAT, [1])
    graph = helper.make_graph([helper.make_node("Neg", ["x"], ["y"])], "other", [value], [out])
    path = tmp_path / "other.onnx"
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9), path)
    with pytest.raises(ModelError, match="not a gapmes model"):
        Engine(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "2"}, "has format 2, this version reads 1"),
        ({"weights_sha256": None, "licence": None}, r"lacks the metadata gapmes.weights_sha256, gapmes.licence"),
        ({"height": "tall"}, "malformed metadata"),
        ({"config": "{"}, "malformed metadata: gapmes.config is no JSON"),
        ({"config": "[]"}, r"malformed metadata: gapmes.config is '\[\]', need a JSON object"),
        ({"config": "3"}, "malformed metadata: gapmes.config is '3'"),
        ({"config": "null"}, "malformed metadata: gapmes.config is 'null'"),
        ({"config": "[" * 100_000}, "malformed metadata: gapmes.config is nested too deeply"),
        ({"tolerance": "[1]"}, "malformed metadata: gapmes.tolerance is"),
        ({"config": '{"experts": -3}'}, "config has experts -3, need a whole number from 1 to 128"),
        ({"config": '{"experts": 129}'}, "config has experts 129, need"),
        ({"config": '{"experts": true}'}, "config has experts True, need"),
        ({"config": '{"depth_planes": 1}'}, "config has depth_planes 1, need a whole number from 2 to 4096"),
        ({"config": '{"depth_planes": 4097}'}, "config has depth_planes 4097, need"),
        ({"config": '{"depth_planes": "64"}'}, "config has depth_planes '64', need"),
        ({"config": '{"depth_planes": 64.0}'}, r"config has depth_planes 64\.0, need"),
        ({"config": f'{{"depth_planes": 1{"0" * 400}}}'}, "config has depth_planes 10+, need"),
        ({"height": "50"}, "need multiples of 16"),
    ],
)
def test_metadata_is_checked(tmp_path, change, message):
    metadata = {key: value for key, value in (METADATA | change).items() if value is not None}
    with pytest.raises(ModelError, match=message):
        Engine(write_standin(tmp_path / "changed.onnx", metadata))


@pytest.mark.parametrize("engine", ["onnxruntime", pytest.param("openvino-fp32", marks=needs_openvino)])
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"height": "64"}, r"takes images of \(any, 3, 48, 64\), .*height 64 .*width 64 mean \(any, 3, 64, 64\)"),
        ({"width": "48"}, r"takes images of \(any, 3, 48, 64\), .* mean \(any, 3, 48, 48\)"),
    ],
)
def test_metadata_that_contradict_the_graph_are_refused(tmp_path, engine, change, message):
    path = write_standin(tmp_path / "changed.onnx", METADATA | change)
    with pytest.raises(ModelError, match=message) as caught:
        Engine(path, threads=1, engine=engine)
    assert caught.value.cure == "export it again with gapmes-export"
    with pytest.raises(ModelError, match=message):
        Engine(path, threads=1, engine=engine, prepare=tmp_path / "prepared")


def test_an_input_of_another_rank_is_refused(tmp_path):
    model = onnx.load(write_standin(tmp_path / "model.onnx"))
    (near_far,) = [value for value in model.graph.input if value.name == "near_far"]
    near_far.type.tensor_type.shape.dim.add().dim_value = 1
    onnx.save(model, tmp_path / "other.onnx")
    with pytest.raises(ModelError, match=r"takes near_far of \(2, 1\), .* mean \(2\)"):
        Engine(tmp_path / "other.onnx", threads=1)


@pytest.mark.parametrize(("axis", "side"), [(0, 2), (2, None), (3, None)])
def test_sides_that_a_graph_leaves_open_or_fixes_are_taken_where_they_fit(tmp_path, axis, side):
    """A graph for two views alone, and graphs for pictures of any height or width."""
    model = onnx.load(write_standin(tmp_path / "model.onnx"))
    (images,) = [value for value in model.graph.input if value.name == "images"]
    dim = images.type.tensor_type.shape.dim[axis]
    dim.Clear()
    if side is None:
        dim.dim_param = "any"
    else:
        dim.dim_value = side
    onnx.save(model, tmp_path / "other.onnx")
    assert set(Engine(tmp_path / "other.onnx", threads=1).run(**inputs(2))) == set(OUTPUTS)


@pytest.mark.parametrize(("said", "kept"), [("true", True), ("false", False), (None, False)])
def test_a_file_says_whether_it_keeps_all(tmp_path, said, kept):
    metadata = METADATA if said is None else METADATA | {"keep_all": said}
    assert Engine(write_standin(tmp_path / "model.onnx", metadata), threads=1).info.keep_all is kept


@pytest.mark.parametrize(("experts", "planes"), [(1, 2), (128, 4096)])
def test_counts_of_the_configuration_are_known(tmp_path, experts, planes):
    config = json.dumps({"experts": experts, "depth_planes": planes})
    info = Engine(write_standin(tmp_path / "model.onnx", METADATA | {"config": config}), threads=1).info
    assert (info.experts, info.depth_planes) == (experts, planes)
    assert (replace(info, config={}).experts, replace(info, config={}).depth_planes) == (None, None)


def test_missing_outputs_are_named(tmp_path):
    kept = tuple(name for name in OUTPUTS if name != "depth")
    with pytest.raises(ModelError, match="lacks the outputs depth"):
        Engine(write_standin(tmp_path / "less.onnx", outputs=kept))


def test_wrong_shapes_and_types_are_refused(engine):
    with pytest.raises(ModelError, match=r"float64 .* needs float32"):
        engine.run(**{**inputs(), "images": inputs()["images"].astype(np.float64)})
    with pytest.raises(ModelError) as caught:
        engine.run(**{**inputs(), "patch_mask": np.ones((2, 3), bool)})
    assert caught.value.field == "patch_mask"


@pytest.mark.case("R3")
def test_numbers_that_are_not_finite_are_named(engine):
    bad = inputs()
    bad["images"][1, 2, 5, 7] = np.nan
    with pytest.raises(ModelError, match=r"1 of \d+ numbers are not finite, first at") as caught:
        engine.run(**bad)
    assert caught.value.field == "harmonics"


def with_one(engine, monkeypatch, name, value):
    """The first number of the second entry of an output is `value`."""
    real = engine._session.run

    def run(names, feed):
        outputs = dict(zip(names, real(names, feed), strict=True))
        outputs[name] = outputs[name].copy()
        outputs[name][(1, *[0] * (outputs[name].ndim - 1))] = value
        return list(outputs.values())

    monkeypatch.setattr(engine._session, "run", run)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", [name for name in OUTPUTS if name != "expert_index"])
def test_one_number_that_is_not_finite_is_refused_in_every_output(engine, monkeypatch, name, value):
    with_one(engine, monkeypatch, name, value)
    with pytest.raises(ModelError, match=r"1 of \d+ numbers are not finite, first at \[1(, 0)*\]") as caught:
        engine.run(**inputs())
    assert caught.value.field == name


@pytest.mark.parametrize(
    ("name", "value", "need"),
    [("scales", -1e-30, "at least 0"), ("opacities", -1e-30, "in [0, 1]"), ("opacities", 1.0000001, "in [0, 1]")],
)
def test_sizes_and_opacities_out_of_range_are_refused(engine, monkeypatch, name, value, need):
    with_one(engine, monkeypatch, name, value)
    with pytest.raises(ModelError) as caught:
        engine.run(**inputs())
    assert caught.value.field == name
    assert f"numbers are not {need}, first at [1" in str(caught.value)


@pytest.mark.parametrize("value", [0.0, -1.0])
def test_depths_that_no_camera_sees_are_refused(engine, monkeypatch, value):
    """Everything after the network divides by them."""
    real = engine._session.run

    def run(names, feed):
        return [np.full_like(v, value) if n == "depth" else v for n, v in zip(names, real(names, feed), strict=True)]

    monkeypatch.setattr(engine._session, "run", run)
    with pytest.raises(ModelError, match="numbers are not above 0") as caught:
        engine.run(**inputs())
    assert caught.value.field == "depth"


@pytest.mark.parametrize(
    ("words", "cure"),
    [("std::bad_alloc", MORE_MEMORY), ("Failed to allocate memory for", MORE_MEMORY), ("?", None)],
)
def test_a_runtime_without_memory_is_told_so(engine, monkeypatch, words, cure):
    def run(names, feed):
        raise engine._session.failures[0](words)

    monkeypatch.setattr(engine._session, "run", run)
    with pytest.raises(ModelError, match="failed on 2 views") as caught:
        engine.run(**inputs())
    assert caught.value.cure == cure


def test_default_model_is_the_packaged_one():
    assert Engine(threads=1).info.file_sha256 == hashlib.sha256(shipped_model().read_bytes()).hexdigest()


def test_loading_leaves_the_processor_as_it_was() -> None:
    """Flushing of denormals is a state of the thread: set here, it would change results in the caller's own code."""
    tiny = np.array([1e-310])
    Engine(shipped_model(), threads=1)
    assert (tiny * 0.5)[0] > 0
