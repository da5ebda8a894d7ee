"""Atomic writing of a model; large weights go into an external file, which all processes can map."""

from __future__ import annotations

import re
import secrets
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from pathlib import Path

import onnx
from onnx.external_data_helper import set_external_data

from gapmes.model.weights_file import file_sha256
from gapmes.service.process.disk import replacing
from gapmes.service.process.ending import done_at_the_end, unfinished

from .metadata import add_metadata

EXTERNAL_BYTES = 64 * 2**20  # total size from which on weights are stored externally
LEAST_BYTES = 1024  # smaller tensors stay in the graph, where shape inference can read them
ALIGNMENT = 4096  # bytes: whole pages, so that a tensor can be mapped by itself
DIGEST = "external_sha256"  # of the file of weights, among the metadata
DIGITS = 12  # of it in that file's name


def write_model(model: onnx.ModelProto, path: Path) -> None:
    """Serialise `model` deterministically to `path`, of a symbolic link to its target; `model` itself is not changed.

    From `EXTERNAL_BYTES` on, weights are stored in NAME.onnx.<first digits of their sha256>.data beside it. The graph
    is replaced last, so that at any moment the existing graph finds its own weights; then those of the previous graph
    are deleted. Whatever ends the writing, no partial file stays (`replacing`), nor weights that no graph names.
    """
    path = path.resolve()  # external weights lie beside the graph
    path.parent.mkdir(parents=True, exist_ok=True)
    changed = onnx.ModelProto()
    changed.CopyFrom(model)
    _forget_digest(changed)
    before = data_files(path)
    outside = sum(len(tensor.raw_data) for tensor in model.graph.initializer) >= EXTERNAL_BYTES
    with _moved_outside(changed, path) if outside else nullcontext() as data, replacing(path) as part:
        part.write_bytes(changed.SerializeToString(deterministic=True))
    for old in before:
        if old != data:
            old.unlink()


def data_files(path: Path) -> list[Path]:
    """The external weights of the model file at `path`, not those of other models in the folder."""
    name = re.compile(rf"{re.escape(path.name)}\.[0-9a-f]{{{DIGITS}}}\.data")
    beside = path.parent.iterdir() if path.parent.is_dir() else ()
    return sorted(file for file in beside if name.fullmatch(file.name))


def remove_model(path: Path) -> None:
    """Delete the graph and its external weights, as far as they exist."""
    path.unlink(missing_ok=True)
    for data in data_files(path):
        data.unlink()


@contextmanager
def _moved_outside(model: onnx.ModelProto, path: Path) -> Iterator[Path]:
    """Move the weights into a file beside `path`; the block writes the graph. Where that fails, or a signal ends it,
    the file is deleted, unless the graph at `path` names it."""
    part = path.with_name(f".gapmes-{secrets.token_hex(8)}.data")
    with unfinished(part), ExitStack() as moved:
        try:
            places = []
            with part.open("wb") as file:
                for tensor in model.graph.initializer:
                    if len(tensor.raw_data) < LEAST_BYTES:
                        continue
                    file.write(bytes(-file.tell() % ALIGNMENT))
                    places.append((tensor, file.tell(), len(tensor.raw_data)))
                    file.write(tensor.raw_data)
            digest = file_sha256(part)
            data = path.with_name(f"{path.name}.{digest[:DIGITS]}.data")
            for tensor, offset, length in places:
                set_external_data(tensor, data.name, offset=offset, length=length)
                tensor.ClearField("raw_data")
            add_metadata(model, {DIGEST: digest})
            moved.enter_context(done_at_the_end(lambda: _drop_unnamed(data, path)))
            part.replace(data)
        finally:
            part.unlink(missing_ok=True)
        try:
            yield data
        except BaseException:
            _drop_unnamed(data, path)
            raise


def _drop_unnamed(data: Path, graph: Path) -> None:
    """Delete a file of weights that the graph does not name."""
    if not graph.is_file() or data.name.encode() not in graph.read_bytes():
        data.unlink(missing_ok=True)


def _forget_digest(model: onnx.ModelProto) -> None:
    """Remove the sha256 of external weights, which are inside the model once it is loaded."""
    kept = [entry for entry in model.metadata_props if entry.key != f"gapmes.{DIGEST}"]
    del model.metadata_props[:]
    model.metadata_props.extend(kept)
