"""Models with external weights, as the exporter writes them."""

from __future__ import annotations

import hashlib
from pathlib import Path

import onnx
from onnx.external_data_helper import set_external_data

LEAST_BYTES = 64  # smaller than any table of weights, larger than what shapes are made of


def write_external(source: Path, path: Path, *, digest: bool = True, location: str | None = None) -> Path:
    """Write `source` to `path` with its tables in `path`.data; returns the path of these. `digest`: the metadata hold
    their hash; `location`: the name of the file in the graph."""
    model = onnx.load(source)
    data = path.with_name(path.name + ".data")
    with data.open("wb") as file:
        for tensor in model.graph.initializer:
            if tensor.HasField("raw_data") and len(tensor.raw_data) >= LEAST_BYTES and len(tensor.dims) > 1:
                file.write(bytes(-file.tell() % 4096))
                set_external_data(tensor, location or data.name, offset=file.tell(), length=len(tensor.raw_data))
                file.write(tensor.raw_data)
                tensor.ClearField("raw_data")
    if digest:
        entry = model.metadata_props.add()
        entry.key, entry.value = "gapmes.external_sha256", hashlib.sha256(data.read_bytes()).hexdigest()
    path.write_bytes(model.SerializeToString(deterministic=True))
    return data
