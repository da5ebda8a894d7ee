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
    """Parse `gapmes.config` of an exported file. Raises `ValueError` and `TypeError` where this version cannot."""
    if "architecture" in json.loads(text):
        return DepthSplatConfig.from_json(text)
    return ModelConfig.from_json(text)


@dataclass(frozen=True)
class Loaded:
    """A network in evaluation mode, and for a foreign checkpoint how each of its tensors was used."""

    network: Network
    fit: Fit | None


def load_network(
    checkpoint: Path,
    architecture: str = "gapmes",
    compatibility: Compatibility = PLAIN,
    scale_max: float | None = None,
) -> Loaded:
    """Load a checkpoint as a network of that architecture; `compatibility` and `scale_max` apply to DepthSplat only.

    Raises `CheckpointError`.
    """
    if architecture == "depthsplat":
        return Loaded(*load_depthsplat(checkpoint, compatibility, scale_max))
    if architecture != "gapmes":
        raise CheckpointError(f"architecture {architecture!r} is unknown, choose one of {', '.join(ARCHITECTURES)}")
    return Loaded(load_checkpoint(checkpoint), None)


def licence(checkpoint: Path, architecture: str) -> str:
    """The licence of the weights, as their publisher states it. Raises `CheckpointError` for a `gapmes` checkpoint that
    cannot be read."""
    if architecture == "depthsplat":
        return DEPTHSPLAT_LICENCE
    return read_metadata(checkpoint).get("gapmes.licence", "not stated")
