"""A model on disk, without loading it: its metadata, its external weights, its size and its sha256."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path, PurePosixPath

from ..errors import ModelError
from .model_info import ModelInfo, parse_model_info
from .onnx_file import OnnxHeader, read_header

EXTERNAL_SHA256 = "gapmes.external_sha256"  # of the external weights, so that the graph's own sha256 covers them too


@dataclass(frozen=True)
class Weights:
    """A file of external weights beside the graph, and the sha256 that the graph records for it."""

    path: Path
    sha256: str

    def check(self) -> None:
        """Raises `ModelError` unless the file has the recorded sha256; it is read once per state of the file."""
        found = sha256_of(self.path)
        if found != self.sha256:
            raise ModelError(
                f"{self.path} has the sha256 {found}, the graph was exported with {self.sha256}",
                field="model",
                cure=_cure(self.path),
            )


@dataclass(frozen=True)
class ModelFile:
    """A gapmes model that has been looked at but not loaded."""

    path: Path
    info: ModelInfo
    weights: Weights | None  # None: inside the graph's file
    bytes: int  # of graph and weights


def model_file(path: Path) -> ModelFile:
    """Read the header and metadata of the model at `path`, and check that its external weights exist and are long
    enough; `Weights.check` compares their content. Raises `ModelError`."""
    try:
        header = read_header(path)
        size = path.stat().st_size
    except OSError as error:
        raise _unreadable(path, error, "make one with gapmes-export, or name another file") from error
    except ValueError as error:
        raise ModelError(f"{path} cannot be loaded, it is no ONNX file: {error}", field="model") from error
    info = parse_model_info(header.metadata, path, sha256_of(path))
    weights = _weights(path, header)
    return ModelFile(path, info, weights, size + (0 if weights is None else weights.path.stat().st_size))


def sha256_of(path: Path) -> str:
    """The file's sha256 in hexadecimal, cached until its inode, size or modification time change. Raises
    `ModelError`."""
    try:
        stat = path.stat()
        return _sha256(path, stat.st_dev, stat.st_ino, stat.st_size, stat.st_mtime_ns)
    except OSError as error:
        raise _unreadable(path, error, None) from error


@lru_cache(maxsize=64)
def _sha256(path: Path, *_: int) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _weights(path: Path, header: OnnxHeader) -> Weights | None:
    """The external weights of the model at `path`, None where it has none. Raises `ModelError` unless they are one file
    beside it that is long enough."""
    if not header.external:
        return None
    if len(header.external) > 1:
        names = ", ".join(sorted(header.external))
        raise ModelError(f"{path} has weights in {len(header.external)} files ({names}), need one", field="model")
    [(name, need)] = header.external.items()
    if PurePosixPath(name).name != name or name in ("", ".", "..") or os.sep in name:
        raise ModelError(f"{path} has weights in {name!r}, need the name of a file beside it", field="model")
    sha256 = header.metadata.get(EXTERNAL_SHA256)
    if sha256 is None:
        raise ModelError(
            f"{path} has weights in {name}, and no metadata {EXTERNAL_SHA256} that says which",
            field="model",
            cure="export it again with this version's gapmes-export",
        )
    data = path.parent / name
    try:
        size = data.stat().st_size
    except OSError as error:
        raise ModelError(
            f"{data} with the weights of {path.name} (sha256 {sha256}) cannot be read: {error.strerror}",
            field="model",
            cure=_cure(data),
        ) from error
    if size < need:
        raise ModelError(f"{data} has {size} bytes, the graph needs {need}", field="model", cure=_cure(data))
    return Weights(data, sha256)


def _cure(data: Path) -> str:
    return f"copy the {data.name} beside it that was exported with it"


def _unreadable(path: Path, error: OSError, cure: str | None) -> ModelError:
    return ModelError(f"{path} cannot be read: {error.strerror}", field="model", cure=cure)
