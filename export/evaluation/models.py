"""The files that are measured: exported ones as they are, checkpoints exported first, each for the
sizes and in the engines wanted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from safetensors import safe_open

from gapmes.model.checkpoint import shipped_checkpoint
from gapmes.model.weights_file import file_sha256
from gapmes.service.backends.choice import DEFAULT_ENGINE, EngineName
from gapmes.service.engine import Arrays, Engine
from gapmes.service.errors import ModelError
from gapmes.service.progress import Listener, silent
from gapmes.service.shipped import shipped_model

from ..pipeline import export_checkpoint

CHECKPOINT = ".safetensors"
_BALANCES = {"experts": "mixture.gates.expert_balance", "tasks": "mixture.gates.task_balance"}


class RecordingEngine(Engine):
    """An engine that keeps what the network returned last: its depths and routes are not part of a scene."""

    last: Arrays

    def run(self, *arguments: object, **named: object) -> Arrays:
        """As `Engine.run`."""
        self.last = super().run(*arguments, **named)  # type: ignore[arg-type]
        return self.last


@dataclass(frozen=True, eq=False)
class Model:
    """A loaded file under the name that the report gives it."""

    label: str
    file: str
    path: Path  # of the ONNX file, where `file` may be the checkpoint that it was exported from
    engine: RecordingEngine
    lambdas: Mapping[str, float] | None  # of Eq. 11, for experts and tasks; None where no checkpoint tells

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in px."""
        return self.engine.info.height, self.engine.info.width


def load_models(
    files: Sequence[Path],
    sizes: Sequence[int],
    folder: Path,
    *,
    threads: int | None = None,
    listener: Listener = silent,
) -> list[Model]:
    """Models of the square `sizes` px, in the order of `files`; without files the shipped one.

    A checkpoint (.safetensors), and the shipped one at other sizes than its own, is exported into `folder` and
    verified. Raises `ModelError` where a size has no model or a file has no size that is wanted, `ExportRejected`,
    `VerificationBroken` and `CheckpointError` of an export.
    """
    if not files:
        return _shipped(sizes, folder, threads, listener)
    found: list[Model] = []
    known = [*(path for path in files if path.suffix == CHECKPOINT), shipped_checkpoint("tiny")]
    checkpoints = {file_sha256(path): path for path in known if path.is_file()}
    for path, label in zip(files, _labels(files), strict=True):
        if path.suffix == CHECKPOINT:
            found += [_exported(path, size, label, folder, threads, listener) for size in sizes]
        else:
            found.append(_loaded(path, label, checkpoints, threads))
    wanted = {(size, size) for size in sizes}
    have = ", ".join(f"{model.file}: {model.size[1]} x {model.size[0]}" for model in found)
    if {model.size for model in found} != wanted:
        raise ModelError(
            f"the files are for other sizes ({have}) than {', '.join(f'{size} x {size}' for size in sizes)} px",
            field="model",
            cure="name a .safetensors checkpoint, which fits all, or export with gapmes-export --size",
        )
    return found


def in_engines(models: Sequence[Model], engines: Sequence[EngineName], threads: int | None) -> list[Model]:
    """Every model in the first engine, then in the next; several are told apart by their labels.

    `models` are as `load_models` gives them, in the default engine. Raises `ModelError` where an engine's package is
    missing, or one is given twice.
    """
    if len(set(engines)) < len(engines):
        raise ModelError(f"{', '.join(engines)}: the same engine twice", field="engine")
    found = []
    for engine in engines:
        for model in models:
            label = model.label if len(engines) == 1 else f"{model.label}, {engine}"
            same = engine == DEFAULT_ENGINE
            loaded = model.engine if same else RecordingEngine(model.path, threads=threads, engine=engine)
            found.append(replace(model, label=label, engine=loaded))
    return found


def model_sizes(files: Sequence[Path]) -> list[int]:
    """Sides in px of the square ONNX files, largest first. Raises `ModelError` for a file that is not square."""
    sizes = set()
    for path in files:
        if path.suffix == CHECKPOINT:
            continue
        info = Engine(path, threads=1).info
        if info.height != info.width:
            raise ModelError(f"{path} is for {info.width} x {info.height} px, need a square size", field="model")
        sizes.add(info.height)
    return sorted(sizes, reverse=True)


def _shipped(sizes: Sequence[int], folder: Path, threads: int | None, listener: Listener) -> list[Model]:
    checkpoint = shipped_checkpoint("tiny")
    own = _loaded(shipped_model(), "ours", {file_sha256(checkpoint): checkpoint}, threads)
    models = []
    for size in sizes:
        if own.size == (size, size):
            models.append(own)
            continue
        if own.lambdas is None:
            raise ModelError(
                f"{own.file} holds other weights than {checkpoint}, which {size} px would be exported from",
                field="model",
                cure="export it again with gapmes-export, or name the files to measure",
            )
        models.append(_exported(checkpoint, size, own.label, folder, threads, listener))
    return models


def _exported(checkpoint: Path, size: int, label: str, folder: Path, threads: int | None, listener: Listener) -> Model:
    if not checkpoint.is_file():
        raise ModelError(f"{checkpoint} is not a file", field="model")
    target = folder / f"{checkpoint.stem}-{size}.onnx"
    export_checkpoint(checkpoint, target, height=size, width=size, quick=True, listener=listener)
    model = _loaded(target, label, {file_sha256(checkpoint): checkpoint}, threads)
    return replace(model, file=checkpoint.name)


def _loaded(path: Path, label: str, checkpoints: Mapping[str, Path], threads: int | None) -> Model:
    engine = RecordingEngine(path, threads=threads)
    checkpoint = checkpoints.get(engine.info.weights_sha256)
    return Model(label, path.name, path, engine, None if checkpoint is None else gate_lambdas(checkpoint))


def gate_lambdas(checkpoint: Path) -> dict[str, float]:
    """`lambda` of Eq. 11 for the gates that the network has; an exported graph holds it folded into constants."""
    with safe_open(checkpoint, framework="pt") as file:
        names = set(file.keys())
        return {
            gate: float(torch.sigmoid(file.get_tensor(name).float()))
            for gate, name in _BALANCES.items()
            if name in names
        }


def _labels(files: Sequence[Path]) -> list[str]:
    """The shortest of stem, name and path that tells the files apart. Raises `ModelError` for a file given twice."""
    for labels in ([p.stem for p in files], [p.name for p in files], [str(p) for p in files]):
        if len(set(labels)) == len(labels):
            return labels
    raise ModelError(f"{', '.join(labels)}: the same file twice", field="model")
