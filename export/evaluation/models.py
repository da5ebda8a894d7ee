"""The evaluated models: exported files, and checkpoints that are exported first, by size and engine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from safetensors import safe_open

from gapmes.model.checkpoint import read_config, shipped_checkpoint
from gapmes.model.weights_file import file_sha256
from gapmes.service.errors import InputError, ModelError
from gapmes.service.network.backends.choice import DEFAULT_ENGINE, EngineName, checked_engine, made_by
from gapmes.service.network.model_file import model_file
from gapmes.service.progress import Listener, silent
from gapmes.service.shipped import shipped_model

from ..memory import OutOfMemory
from ..pipeline import ExportRejected, VerificationBroken, export_checkpoint
from ..recording_engine import RecordingEngine
from ..size import Size
from .labels import given_twice, shortest_names
from .scores import BASELINES, TRUE_DEPTH

CHECKPOINT = ".safetensors"
_BALANCES = {"experts": "mixture.gates.expert_balance", "tasks": "mixture.gates.task_balance"}


@dataclass(frozen=True, eq=False)
class Model:
    """A loaded file under the name that the report gives it."""

    label: str
    file: str
    engine: RecordingEngine
    lambdas: Mapping[str, float] | None  # of Eq. 11, for experts and tasks; None if the checkpoint is unknown

    @property
    def size(self) -> Size:
        return Size(self.engine.info.height, self.engine.info.width)


def load_models(
    files: Sequence[Path],
    sizes: Sequence[Size],
    folder: Path,
    *,
    engines: Sequence[EngineName] = (DEFAULT_ENGINE,),
    threads: int | None = None,
    listener: Listener = silent,
) -> list[Model]:
    """Models of these `sizes`, in the order of `files`, each in all `engines`; without files the shipped one.

    With several engines the labels name them. A checkpoint (.safetensors), and the shipped one at other sizes than its
    own, is exported into `folder` and verified. Raises `ModelError` where a size has no model, a file has no size that
    is wanted, or a checkpoint cannot be exported.
    """
    runtime = _Runtime(engines, threads)
    if not files:
        return _shipped(sizes, folder, runtime, listener)
    found: list[Model] = []
    known = [*(path for path in files if path.suffix == CHECKPOINT), shipped_checkpoint("tiny")]
    checkpoints = {file_sha256(path): path for path in known if path.is_file()}
    labels = dict(zip(files, _labels(files), strict=True))
    loaded = {p: runtime.load(p, labels[p], checkpoints) for p in files if p.suffix != CHECKPOINT}  # before all exports
    for path, label in labels.items():
        if path.suffix == CHECKPOINT:
            found += [m for size in sizes for m in _exported(path, size, label, folder, runtime, listener)]
        else:
            found += loaded[path]
    have = ", ".join(dict.fromkeys(f"{model.file}: {model.size}" for model in found))
    if {model.size for model in found} != set(sizes):
        raise ModelError(
            f"the files are for other sizes ({have}) than {', '.join(map(str, sizes))} px",
            field="model",
            cure="name a .safetensors checkpoint, which fits all, or export with gapmes-export --size",
        )
    return found


def checked_engines(names: Sequence[str]) -> list[EngineName]:
    """`names` as engines. Raises `ModelError` for one that is unknown, given twice or whose package is missing."""
    engines = [checked_engine(name) for name in names]
    if len(set(engines)) < len(engines):
        raise ModelError(f"{', '.join(engines)}: the same engine twice", field="engine")
    for engine in engines:
        made_by(engine)
    return engines


def check_sizes(files: Sequence[Path], sizes: Sequence[Size]) -> None:
    """Raises `InputError` for a size that a checkpoint among the files, or without files the shipped one, cannot be
    exported for, and `CheckpointError` for a file that is none."""
    sources = [path for path in files if path.suffix == CHECKPOINT] if files else [shipped_checkpoint("tiny")]
    for source in sources:
        step = read_config(source).size_step
        for size in sizes:
            if misfit := size.misfit(step):
                raise InputError(f"{source.name} cannot be exported for {size} px: {misfit}", field="size")


def exports(files: Sequence[Path], sizes: Sequence[Size]) -> list[tuple[str, Size]]:
    """Name and size of each checkpoint that `load_models` exports."""
    if files:
        return [(path.name, size) for path in files if path.suffix == CHECKPOINT for size in sizes]
    own = model_sizes([shipped_model()])
    return [(shipped_checkpoint("tiny").name, size) for size in sizes if size not in own]


def model_sizes(files: Sequence[Path]) -> list[Size]:
    """The sizes of the ONNX files, largest first."""
    infos = [model_file(path).info for path in files if path.suffix != CHECKPOINT]  # not loaded, which takes seconds
    return sorted({Size(info.height, info.width) for info in infos}, key=Size.order, reverse=True)


@dataclass(frozen=True)
class _Runtime:
    """The engines and threads that files are loaded with."""

    engines: Sequence[EngineName]
    threads: int | None

    def load(self, path: Path, label: str, checkpoints: Mapping[str, Path]) -> list[Model]:
        """The ONNX file in every engine; `checkpoints` maps the sha256 of known weights to their files."""
        models = []
        for name in self.engines:
            engine = RecordingEngine(path, threads=self.threads, engine=name)
            checkpoint = checkpoints.get(engine.info.weights_sha256)
            lambdas = None if checkpoint is None else gate_lambdas(checkpoint)
            told = label if len(self.engines) == 1 else f"{label}, {name}"
            models.append(Model(told, path.name, engine, lambdas))
        return models


def _shipped(sizes: Sequence[Size], folder: Path, runtime: _Runtime, listener: Listener) -> list[Model]:
    checkpoint = shipped_checkpoint("tiny")
    shipped = runtime.load(shipped_model(), "ours", {file_sha256(checkpoint): checkpoint})
    own = shipped[0]
    models = []
    for size in sizes:
        if own.size == size:
            models += shipped
            continue
        if own.lambdas is None:
            raise ModelError(
                f"{own.file} holds other weights than {checkpoint}, which {size} px would be exported from",
                field="model",
                cure="export it again with gapmes-export, or name the files to measure",
            )
        models += _exported(checkpoint, size, "ours", folder, runtime, listener)
    return models


def _exported(
    checkpoint: Path, size: Size, label: str, folder: Path, runtime: _Runtime, listener: Listener
) -> list[Model]:
    if not checkpoint.is_file():
        raise ModelError(f"{checkpoint} is not a file", field="model")
    target = folder / f"{checkpoint.stem}-{size}.onnx"
    try:
        export_checkpoint(checkpoint, target, height=size.height, width=size.width, quick=True, listener=listener)
    except (ExportRejected, VerificationBroken, OutOfMemory, ValueError) as error:
        raise ModelError(f"{checkpoint.name} cannot be exported for {size} px: {error}", field="model") from error
    return [
        replace(m, file=checkpoint.name) for m in runtime.load(target, label, {file_sha256(checkpoint): checkpoint})
    ]


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
    """The stems of the files, or more of their paths where these are not distinct or coincide with a baseline. Raises
    `ModelError` for a file given twice."""
    if (twice := given_twice(files)) is not None:
        raise ModelError(f"{twice} is given twice", field="model")
    stems, taken = [path.stem for path in files], {*BASELINES, TRUE_DEPTH}
    apart = len(set(stems)) == len(stems) and not set(stems) & taken
    return stems if apart else shortest_names(files, taken)
