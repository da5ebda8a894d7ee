"""Checkpoints as safetensors: weights, the configuration that built them, and their sha256."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file

from .config import ModelConfig
from .network import GaPMeS

WEIGHTS_LICENCE = "MIT"
SHIPPED = Path(__file__).parent / "weights"


class CheckpointError(ValueError):
    """A file that is not a checkpoint of ours, or that does not fit the configuration it claims."""


def shipped_checkpoint(preset: str) -> Path:
    """Path of the checkpoint that the package carries for a preset; raises `CheckpointError` when it carries none."""
    path = SHIPPED / f"{preset}.safetensors"
    if not path.is_file():
        shipped = sorted(p.stem for p in SHIPPED.glob("*.safetensors"))
        raise CheckpointError(f"no weights are shipped for preset {preset!r} (shipped: {', '.join(shipped)})")
    return path


def save_checkpoint(path: Path, model: GaPMeS, *, extra: dict[str, str] | None = None) -> None:
    """Write the weights and the configuration, whole or not at all."""
    tensors = {name: value.detach().cpu().contiguous() for name, value in model.state_dict().items()}
    metadata = {"gapmes.config": model.config.to_json(), "gapmes.licence": WEIGHTS_LICENCE}
    metadata |= model.provenance | (extra or {})
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    save_file(tensors, part, metadata=metadata)
    os.replace(part, path)


def read_metadata(path: Path) -> dict[str, str]:
    """What a checkpoint says of itself; raises `CheckpointError` when it is not one of ours."""
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
    except (OSError, SafetensorError) as error:
        cure = "" if path.suffix == ".safetensors" else "; a DepthSplat .pth goes with --architecture depthsplat"
        raise CheckpointError(f"{path} cannot be read as safetensors: {error}{cure}") from error
    if "gapmes.config" not in metadata:
        raise CheckpointError(f"{path} carries no gapmes.config; is it a checkpoint of another network?")
    return metadata


def read_config(path: Path) -> ModelConfig:
    """The configuration that a checkpoint was trained with. Raises `CheckpointError`."""
    text = read_metadata(path)["gapmes.config"]
    try:
        return ModelConfig.from_json(text)
    except (KeyError, TypeError, ValueError) as error:
        raise CheckpointError(f"{path} has a configuration that this version cannot build: {error!r}") from error


def load_checkpoint(path: Path) -> GaPMeS:
    """Build the network that the file describes and load every tensor strictly, in float32 and evaluation mode.

    Raises `CheckpointError` that names what is missing, unexpected or misshapen.
    """
    model = GaPMeS(read_config(path))
    tensors = load_file(path)
    kept = ("gapmes.licence", "gapmes.backbones")
    model.provenance = {key: value for key, value in read_metadata(path).items() if key in kept}
    expected = model.state_dict()
    missing, unexpected = sorted(expected.keys() - tensors.keys()), sorted(tensors.keys() - expected.keys())
    shapes = [
        f"{name} {tuple(tensors[name].shape)} instead of {tuple(expected[name].shape)}"
        for name in expected.keys() & tensors.keys()
        if tensors[name].shape != expected[name].shape
    ]
    if missing or unexpected or shapes:
        raise CheckpointError(
            f"{path} does not fit its configuration: missing {missing[:5]}, unexpected {unexpected[:5]}, "
            f"misshapen {sorted(shapes)[:5]} ({len(missing)}, {len(unexpected)}, {len(shapes)} in all)"
        )
    model.load_state_dict({k: v.to(torch.float32) if v.is_floating_point() else v for k, v in tensors.items()})
    return model.eval()


def file_sha256(path: Path) -> str:
    """Hex digest of a file's bytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
