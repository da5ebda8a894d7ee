"""The networks that can be exported, and how a file or a checkpoint says which one it is."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from .checkpoint import load_checkpoint, read_metadata
from .config import ModelConfig
from .depthsplat.checkpoint import LICENCE as DEPTHSPLAT_LICENCE
from .depthsplat.checkpoint import load_depthsplat
from .depthsplat.config import PLAIN, Compatibility, DepthSplatConfig
from .depthsplat.network import DepthSplat
from .network import GaPMeS
from .pretrained.fit import Fit
from .weights_file import CheckpointError

ARCHITECTURES = ("gapmes", "depthsplat")

Network = GaPMeS | DepthSplat
NetworkConfig = ModelConfig | DepthSplatConfig


def config_from_json(text: str) -> NetworkConfig:
    """Of an exported file's metadata. Raises `ValueError` and `TypeError` for one that this version cannot read."""
    if "architecture" in json.loads(text):
        return DepthSplatConfig.from_json(text)
    return ModelConfig.from_json(text)


@dataclass(frozen=True)
class Loaded:
    """A network in evaluation mode, and what became of every tensor of a file that is not ours."""

    network: Network
    fit: Fit | None


def load_network(
    checkpoint: Path,
    architecture: str = "gapmes",
    compatibility: Compatibility = PLAIN,
    scale_max: float | None = None,
) -> Loaded:
    """The last two are of DepthSplat. Raises `CheckpointError`."""
    if architecture == "depthsplat":
        return Loaded(*load_depthsplat(checkpoint, compatibility, scale_max))
    if architecture != "gapmes":
        raise CheckpointError(f"architecture {architecture!r} is unknown, choose one of {', '.join(ARCHITECTURES)}")
    return Loaded(load_checkpoint(checkpoint), None)


def licence(checkpoint: Path, architecture: str) -> str:
    """Of the weights, as their publisher states it. Raises `CheckpointError` for a file that is not ours."""
    if architecture == "depthsplat":
        return DEPTHSPLAT_LICENCE
    return read_metadata(checkpoint).get("gapmes.licence", "not stated")
