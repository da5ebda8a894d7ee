"""The header of an .onnx file: as the onnx package reads it, and only `ValueError` for other files."""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from pathlib import Path

import numpy as np
import onnx
import pytest
from external_model import write_external
from hypothesis import given
from hypothesis import strategies as st
from onnx import TensorProto, helper, numpy_helper

from gapmes.service.errors import ModelError
from gapmes.service.network.engine import Engine
from gapmes.service.network.onnx_file import OnnxHeader, read_header
from gapmes.service.shipped import shipped_model

MESSAGE = st.recursive(  # bytes that are much like a protobuf
    st.binary(max_size=12),
    lambda inner: st.lists(st.tuples(st.sampled_from([1, 5, 6, 7, 11, 13, 14]), inner), max_size=4).map(
        lambda fields: b"".join(bytes([number << 3 | 2, len(value) & 127]) + value for number, value in fields)
    ),
)


@pytest.mark.parametrize("path", [shipped_model(), None], ids=["shipped", "stand-in"])
def test_metadata_are_those_of_the_onnx_package(path: Path | None, standin_model: Path) -> None:
    found = read_header(path or standin_model)
    told = {entry.key: entry.value for entry in onnx.load(path or standin_model).metadata_props}
    assert found == OnnxHeader(told, {})


def test_tensors_beside_the_graph_are_found_with_where_they_end(tmp_path: Path, standin_model: Path) -> None:
    data = write_external(standin_model, tmp_path / "m.onnx")
    assert read_header(tmp_path / "m.onnx").external == {"m.onnx.data": data.stat().st_size}


def test_tensors_of_bodies_and_constants_are_found_too(tmp_path: Path) -> None:
    def outside(name: str, offset: int) -> TensorProto:
        tensor = numpy_helper.from_array(np.ones((4, 4), np.float32), name)
        tensor.ClearField("raw_data")
        tensor.data_location = TensorProto.EXTERNAL
        for key, value in (("location", f"{name}.bin"), ("offset", str(offset)), ("length", "64")):
            tensor.external_data.add(key=key, value=value)
        return tensor

    out = helper.make_tensor_value_info("y", TensorProto.FLOAT, [4, 4])
    constant = helper.make_node("Constant", [], ["y"], value=outside("constant", 0))
    body = helper.make_graph([constant], "body", [], [out], [outside("inner", 128)])
    condition = helper.make_tensor_value_info("c", TensorProto.BOOL, [])
    node = helper.make_node("If", ["c"], ["y"], then_branch=body, else_branch=body)
    model = helper.make_model(helper.make_graph([node], "outer", [condition], [out]))
    (tmp_path / "m.onnx").write_bytes(model.SerializeToString())
    assert read_header(tmp_path / "m.onnx").external == {"constant.bin": 64, "inner.bin": 192}


def test_what_would_never_end_is_not_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.onnx")
    for path in (tmp_path / "pipe.onnx", Path("/dev/zero")):
        with pytest.raises(ValueError, match="it is a device or a pipe"):
            read_header(path)
        with pytest.raises(ModelError, match="it is no ONNX file: it is a device or a pipe"):
            Engine(path)


def header_of(data: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "m.onnx"
        path.write_bytes(data)
        read_header(path)


@given(st.one_of(st.binary(max_size=64), MESSAGE))
def test_what_is_no_onnx_file_is_a_value_error(data: bytes) -> None:
    with suppress(ValueError):
        header_of(data)


@given(st.data())
def test_a_file_that_was_cut_off_is_refused_or_has_all_of_its_graph(standin_model: Path, data: st.DataObject) -> None:
    whole = standin_model.read_bytes()
    length = data.draw(st.integers(0, len(whole) - 1))
    try:
        header_of(whole[:length])
    except ValueError:
        return
    onnx.load_from_string(whole[:length])  # the cut lies between two fields


def test_an_empty_file_and_one_without_a_graph(tmp_path: Path) -> None:
    (tmp_path / "m.onnx").write_bytes(b"")
    with pytest.raises(ValueError, match="empty"):
        read_header(tmp_path / "m.onnx")
    (tmp_path / "m.onnx").write_bytes(onnx.ModelProto(ir_version=9).SerializeToString())
    with pytest.raises(ValueError, match="no graph"):
        read_header(tmp_path / "m.onnx")
