"""Checkpoints as safetensors: weights, the configuration that built them, and their sha256."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from .config import PRESETS, ModelConfig
from .overflow import refuse_overflow
from .pretrained.files import read_tensors
from .pretrained.recognise import looks_like
from .pretrained.safetensors_file import NotSafetensors, read_safetensors, read_safetensors_metadata
from .saved_tensors import save_tensors
from .tensor_checks import refuse_non_finite, refuse_other_kinds
from .weights_file import CheckpointError, some, why_no_file, wrapper_of

if TYPE_CHECKING:
    from .network import GaPMeS

WEIGHTS_LICENCE = "MIT"
SHIPPED = Path(__file__).parent / "weights"
WEIGHTS = "weights.safetensors"  # in the folder of a training
STATE_PARTS = {"average", "optimiser"}  # beside the weights in the state of a training


def _architecture() -> type[GaPMeS]:
    from .network import GaPMeS  # takes seconds, which processes that draw scenes or write files do without

    return GaPMeS


def shipped_checkpoint(preset: str) -> Path:
    """Path of the checkpoint that the package carries for a preset; raises `CheckpointError` when it carries none."""
    path = SHIPPED / f"{preset}.safetensors"
    if not path.is_file():
        shipped = sorted(p.stem for p in SHIPPED.glob("*.safetensors"))
        raise CheckpointError(f"no weights are shipped for preset {preset!r} (shipped: {', '.join(shipped)})")
    return path


def save_checkpoint(path: Path, model: GaPMeS, *, extra: dict[str, str] | None = None) -> None:
    """Write weights and configuration atomically; equal ones give equal bytes. Raises `OSError`."""
    tensors = {name: value.detach().cpu().contiguous() for name, value in model.state_dict().items()}
    metadata = {"gapmes.config": model.config.to_json(), "gapmes.licence": WEIGHTS_LICENCE}
    metadata |= model.provenance | (extra or {})
    save_tensors(path, tensors, metadata)


def read_metadata(path: Path) -> dict[str, str]:
    """The metadata of a checkpoint. Raises `CheckpointError` for another file, naming what it seems to be."""
    if not path.is_file():
        raise CheckpointError(why_no_file(path))
    try:
        metadata = read_safetensors_metadata(path)
    except CheckpointError as error:
        likely = _likely(path)
        raise CheckpointError(f"{path} cannot be read as safetensors{likely}" if likely else str(error)) from error
    if "gapmes.config" not in metadata:
        raise CheckpointError(f"{path} carries no gapmes.config: it is no checkpoint of ours{_likely(path)}")
    return metadata


def _likely(path: Path) -> str:
    """What a file that is no checkpoint seems to be, as the end of a sentence; empty if unknown."""
    try:
        file = read_tensors(path)
    except NotSafetensors:  # its caller says so
        return ""
    except CheckpointError as error:
        return f"; {error}"
    if set(file.set_aside) >= STATE_PARTS:
        return f"; it holds the state of a training: give {WEIGHTS} beside it, which has the averaged weights"
    own = _preset_of(file.tensors)
    kind = f"the tensors of preset {own}, whose configuration is lost" if own else looks_like(path, file.tensors)
    return f"; it holds {kind}" if kind else ""


def _preset_of(tensors: Mapping[str, Tensor]) -> str:
    """The preset with exactly these tensor names, behind a `wrapper_of` all of them, and shapes, or an empty string."""
    wrapper = wrapper_of(tensors)
    shapes = {name.removeprefix(wrapper): value.shape for name, value in tensors.items()}
    architecture = _architecture()
    for name, config in PRESETS.items():
        with torch.device("meta"):
            wanted = {key: value.shape for key, value in architecture(config).state_dict().items()}
        if shapes == wanted:
            return name
    return ""


def _differing(config: ModelConfig, name: str) -> str:
    """The fields in which a configuration is not that of the preset."""
    wanted = asdict(PRESETS[name])
    return ", ".join(field for field, value in asdict(config).items() if value != wanted[field])


def read_config(path: Path) -> ModelConfig:
    """The configuration that a checkpoint was trained with. Raises `CheckpointError`."""
    text = read_metadata(path)["gapmes.config"]
    try:
        return ModelConfig.from_json(text)
    except ValueError as error:
        raise CheckpointError(f"{path} has a gapmes.config that this version cannot build: {error}") from error


def load_checkpoint(path: Path) -> GaPMeS:
    """Build the network that the file describes and load every tensor strictly, in float32 and evaluation mode.

    Names may be prefixed as by `torch.compile` (`wrapper_of`). Raises `CheckpointError` that names what is missing,
    unexpected or misshapen, is not in floating point or not finite, or where the network overflows.
    """
    config = read_config(path)
    expected, (tensors, metadata) = _tensors_of(path, config), read_safetensors(path)
    wrapper = wrapper_of(tensors)
    tensors = {name.removeprefix(wrapper): value for name, value in tensors.items()}
    if wrong := _misfit(expected, tensors):
        own = _preset_of(tensors)
        cure = f"; its tensors are preset {own}'s, its configuration has other {_differing(config, own)}" if own else ""
        raise CheckpointError(f"{path} does not fit its configuration (preset {config.preset}): {wrong}{cure}")
    refuse_other_kinds(path, tensors)
    weights = {name: value.to(torch.float32) for name, value in tensors.items()}
    refuse_non_finite(path, weights)
    model = _architecture()(config)
    kept = ("gapmes.licence", "gapmes.backbones")
    model.provenance = {key: value for key, value in metadata.items() if key in kept}
    model.load_state_dict(weights)
    refuse_overflow(path, model.eval())
    return model


def _misfit(expected: Mapping[str, Tensor], tensors: Mapping[str, Tensor]) -> str:
    """Which tensors are missing, unexpected or misshapen, with their numbers; empty where all fit."""
    misshapen = [
        f"{name} {tuple(tensors[name].shape)} instead of {tuple(expected[name].shape)}"
        for name in sorted(expected.keys() & tensors.keys())
        if tensors[name].shape != expected[name].shape
    ]
    kinds = {
        "missing": sorted(expected.keys() - tensors.keys()),
        "unexpected": sorted(tensors.keys() - expected.keys()),
        "misshapen": misshapen,
    }
    return "; ".join(f"{kind} ({len(names)}): {some(names)}" for kind, names in kinds.items() if names)


def _tensors_of(path: Path, config: ModelConfig) -> Mapping[str, Tensor]:
    """The state dict of the network of `config` on the meta device, which takes no memory. Raises `CheckpointError`
    for a configuration that no network has."""
    architecture = _architecture()
    try:
        with torch.device("meta"):
            return architecture(config).state_dict()
    except (RuntimeError, ValueError, TypeError, ArithmeticError) as error:
        raise CheckpointError(f"{path} has a configuration that no network has: {error}") from error
