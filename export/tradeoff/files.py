"""The model files of the report: the shipped one, its int8 variant, and exports with other settings."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import onnx

from gapmes.model.architectures import Network
from gapmes.model.checkpoint import WEIGHTS_LICENCE, shipped_checkpoint
from gapmes.model.weights_file import file_sha256
from gapmes.service.network.onnx_file import read_header
from gapmes.service.shipped import shipped_model

from ..memory import ended_for_lack_of_memory
from ..metadata import add_metadata, contract_metadata
from ..model_file import DIGEST, write_model
from ..quantise import quantised
from ..variant import Variant, load_variant
from .child import ChildFailed

FOLDER = "models"  # of the report's folder: what is made here takes the place of no file of the user's
EXPORT = (
    "import sys; from gapmes.export.tradeoff.files import export_variant; "
    "export_variant(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4] == 'all')"
)
_NOT_ASKED = ("tolerance", DIGEST)  # metadata that tells what was found, and where


@dataclass(frozen=True)
class ModelFile:
    """A file under its knob; `variant` is how torch computes the same."""

    knob: str
    value: str
    how: str
    path: Path
    variant: Variant = field(default_factory=Variant)
    size: int = 256


def quick_files(out: Path) -> list[ModelFile]:
    """The shipped file and its int8 form, which takes seconds."""
    target = out / FOLDER / "int8.onnx"
    asked = {**_metadata_of(shipped_model()), "precision": "int8"}
    if not _says(target, asked):
        model = quantised(onnx.load(shipped_model()))
        add_metadata(model, {"precision": "int8", "tolerance": "{}"})  # that of the shipped file is of float32
        write_model(model, target)
    return [
        ModelFile("precision", "fp32", "gapmes-export --precision fp32", shipped_model()),
        ModelFile("precision", "int8", "gapmes-export --precision int8", target),
    ]


def all_files(out: Path) -> list[ModelFile]:
    """`quick_files` and exports that take minutes, two at a time. Files of an earlier report are reused where their
    metadata match. Raises `ChildFailed`."""
    folder = out / FOLDER
    more = [
        ModelFile("experts per patch", "1", "gapmes-export --top-k 1", folder / "top1.onnx", Variant(top_k=1)),
        ModelFile("skipping", "nothing", "gapmes-export --keep-all", folder / "all.onnx", Variant(keep_all=True)),
        ModelFile("input size", "128", "gapmes-export --size 128x128", folder / "size128.onnx", size=128),
    ]
    _export_elsewhere([file for file in more if not _says(file.path, _asked(file))])
    return quick_files(out) + more


def _export_elsewhere(files: Sequence[ModelFile]) -> None:
    running: list[tuple[ModelFile, subprocess.Popen[bytes]]] = []
    try:
        for file in files:
            if len(running) == 2:
                _finish(*running.pop(0))
            keep = "all" if file.variant.keep_all else "needed"
            arguments = [str(file.path), str(file.size), str(file.variant.top_k or 0), keep]
            running.append((file, subprocess.Popen([sys.executable, "-c", EXPORT, *arguments])))
        while running:
            _finish(*running.pop(0))
    finally:
        for _, process in running:  # beside one that failed
            process.kill()
            process.wait()


def _finish(file: ModelFile, process: subprocess.Popen[bytes]) -> None:
    if process.wait() != 0:
        raise ChildFailed(f"the export of {file.path}", process.returncode)


def _says(path: Path, asked: Mapping[str, str]) -> bool:
    """Whether `path` is a model with exactly this metadata."""
    try:
        return _metadata_of(path) == asked
    except (OSError, ValueError):  # none, or no model
        return False


def _metadata_of(path: Path) -> dict[str, str]:
    found = {key.removeprefix("gapmes."): value for key, value in read_header(path).metadata.items()}
    return {key: value for key, value in found.items() if key not in _NOT_ASKED}


def _asked(file: ModelFile) -> dict[str, str]:
    return _metadata(load_variant(shipped_checkpoint("tiny"), file.variant).network, file.size, file.variant.keep_all)


def _metadata(network: Network, size: int, keep_all: bool) -> dict[str, str]:
    metadata = contract_metadata(
        network,
        height=size,
        width=size,
        weights_sha256=file_sha256(shipped_checkpoint("tiny")),
        licence=WEIGHTS_LICENCE,
        precision="fp32",
    )
    return metadata | ({"keep_all": "true"} if keep_all else {})


def export_variant(path: str, size: int, top_k: int, keep_all: bool) -> None:
    """Export the shipped checkpoint without verifying it: for measuring, not for serving."""
    from ..build import export_graph

    with ended_for_lack_of_memory():
        network = load_variant(shipped_checkpoint("tiny"), Variant(top_k or None, keep_all)).network
        model = export_graph(network, size, size)
        add_metadata(model, _metadata(network, size, keep_all))
        write_model(model, Path(path))
