"""Writing a model whole or not at all: large weights go into a file beside the graph, which every process can map."""

from __future__ import annotations

import hashlib
from pathlib import Path

import onnx
from onnx.external_data_helper import set_external_data

from .metadata import add_metadata

EXTERNAL_BYTES = 64 * 2**20  # of weights, from which on they go into a file of their own
LEAST_BYTES = 1024  # smaller tensors stay in the graph, where shape inference can read them
ALIGNMENT = 4096  # bytes: whole pages, so that a tensor can be mapped by itself
DATA_SUFFIX = ".data"
DIGEST = "external_sha256"  # of the file of weights, among the metadata


def write_model(model: onnx.ModelProto, path: Path) -> None:
    """Serialise deterministically. From `EXTERNAL_BYTES` of weights on they are in NAME.onnx.data beside it, whose
    sha256 the metadata tell; `model` itself is left as it is."""
    path.parent.mkdir(parents=True, exist_ok=True)
    data, part = data_path(path), path.with_name(path.name + ".part")
    if sum(len(tensor.raw_data) for tensor in model.graph.initializer) < EXTERNAL_BYTES:
        part.write_bytes(model.SerializeToString(deterministic=True))
        part.replace(path)
        data.unlink(missing_ok=True)
        return
    data_part = data.with_name(data.name + ".part")
    outside = _with_external_data(model, data_part, data.name)
    part.write_bytes(outside.SerializeToString(deterministic=True))
    data_part.replace(data)
    part.replace(path)


def data_path(path: Path) -> Path:
    """Of the weights that belong to a model file, if it has any outside."""
    return path.with_name(path.name + DATA_SUFFIX)


def remove_model(path: Path) -> None:
    """The graph and its weights."""
    path.unlink()
    data_path(path).unlink(missing_ok=True)


def _with_external_data(model: onnx.ModelProto, data: Path, location: str) -> onnx.ModelProto:
    changed = onnx.ModelProto()
    changed.CopyFrom(model)
    with data.open("wb") as file:
        for tensor in changed.graph.initializer:
            if len(tensor.raw_data) < LEAST_BYTES:
                continue
            file.write(bytes(-file.tell() % ALIGNMENT))
            set_external_data(tensor, location, offset=file.tell(), length=len(tensor.raw_data))
            file.write(tensor.raw_data)
            tensor.ClearField("raw_data")
    with data.open("rb") as file:
        add_metadata(changed, {DIGEST: hashlib.file_digest(file, "sha256").hexdigest()})
    return changed
