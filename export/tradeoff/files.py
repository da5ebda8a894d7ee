"""The model files that the report compares: the shipped one, its int8 form, and exports with other settings."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import onnx

from gapmes.model.checkpoint import WEIGHTS_LICENCE, shipped_checkpoint
from gapmes.model.weights_file import file_sha256
from gapmes.service.shipped import shipped_model

from ..metadata import add_metadata
from ..model_file import write_model
from ..quantise import quantised
from ..variant import Variant

EXPORT = (
    "import sys; from gapmes.export.tradeoff.files import export_variant; "
    "export_variant(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4] == 'all')"
)


@dataclass(frozen=True)
class ModelFile:
    """A file under its knob; `variant` is how torch computes the same."""

    knob: str
    value: str
    how: str
    path: Path
    variant: Variant = field(default_factory=Variant)
    size: int = 256


def quick_files(folder: Path) -> list[ModelFile]:
    """The shipped file and its int8 form, which takes seconds."""
    target = folder / "int8.onnx"
    if not _is_of_shipped_weights(target):
        model = quantised(onnx.load(shipped_model()))
        add_metadata(model, {"precision": "int8"})
        write_model(model, target)
    return [
        ModelFile("precision", "fp32", "gapmes-export --precision fp32", shipped_model()),
        ModelFile("precision", "int8", "gapmes-export --precision int8", target),
    ]


def all_files(folder: Path) -> list[ModelFile]:
    """With the exports that take minutes; two are made at a time. What the folder holds already is used again."""
    more = [
        ModelFile("experts per patch", "1", "gapmes-export --top-k 1", folder / "top1.onnx", Variant(top_k=1)),
        ModelFile("skipping", "nothing", "gapmes-export --keep-all", folder / "all.onnx", Variant(keep_all=True)),
        ModelFile("input size", "128", "gapmes-export --size 128x128", folder / "size128.onnx", size=128),
    ]
    waiting = [file for file in more if not _is_of_shipped_weights(file.path)]
    running: list[subprocess.Popen[bytes]] = []
    for file in waiting:
        if len(running) == 2:
            _finish(running.pop(0))
        keep = "all" if file.variant.keep_all else "needed"
        arguments = [str(file.path), str(file.size), str(file.variant.top_k or 0), keep]
        running.append(subprocess.Popen([sys.executable, "-c", EXPORT, *arguments]))
    for process in running:
        _finish(process)
    return quick_files(folder) + more


def _is_of_shipped_weights(path: Path) -> bool:
    """Whether an earlier report left this file, and the shipped network is still the same."""
    if not path.is_file():
        return False
    weights = {entry.key: entry.value for entry in onnx.load(path).metadata_props}.get("gapmes.weights_sha256")
    return weights == file_sha256(shipped_checkpoint("tiny"))


def _finish(process: subprocess.Popen[bytes]) -> None:
    if process.wait() != 0:
        raise RuntimeError(f"an export of the report ended with {process.returncode}")


def export_variant(path: str, size: int, top_k: int, keep_all: bool) -> None:
    """Export the shipped checkpoint without verifying it: for measuring, not for serving."""
    from ..build import export_graph
    from ..metadata import contract_metadata
    from ..variant import load_variant

    checkpoint = shipped_checkpoint("tiny")
    network = load_variant(checkpoint, Variant(top_k or None, keep_all)).network
    model = export_graph(network, size, size)
    metadata = contract_metadata(
        network,
        height=size,
        width=size,
        weights_sha256=file_sha256(checkpoint),
        licence=WEIGHTS_LICENCE,
        precision="fp32",
    )
    add_metadata(model, metadata | ({"keep_all": "true"} if keep_all else {}))
    write_model(model, Path(path))
