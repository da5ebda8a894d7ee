"""The frozen parts of a preset from published weights, and the record of where each came from."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields

from ..backbones import DepthAnythingFeatures
from ..checkpoint import WEIGHTS_LICENCE
from ..full_trunk import FullTrunk
from ..network import GaPMeS
from ..weights_file import CheckpointError
from .depth_anything import load_depth_anything
from .dinov2 import load_vit
from .fit import Fit
from .trunk import load_trunk

RECORD = "gapmes.backbones"  # of a checkpoint's metadata


@dataclass(frozen=True)
class BackboneSources:
    """A file, a folder or a hub name for each frozen part."""

    semantic: str  # DINOv2
    trunk: str  # UniMatch (GMFlow, GMDepth) or DepthSplat
    depth: str | None  # Depth-Anything-V2; None for a network without the depth stream


def load_backbones(network: GaPMeS, sources: BackboneSources) -> dict[str, Fit]:
    """Load all parts strictly and note their origin in `network.provenance`, which goes into its checkpoints.

    Raises `CheckpointError` for weights that do not fit, naming the part, and for a network without such parts.
    """
    if not isinstance(network.trunk, FullTrunk):
        raise CheckpointError(f"preset {network.config.preset} has no parts that published weights go into")
    if (network.mono is None) != (sources.depth is None):
        state = "has no depth stream, but depth weights are given" if network.mono is None else "needs depth weights"
        raise CheckpointError(f"this network of preset {network.config.preset} {state}")
    found: dict[str, Fit] = {}
    for field in fields(sources):
        source = getattr(sources, field.name)
        try:
            if field.name == "semantic":
                found[field.name] = load_vit(network.semantic, source)
            elif field.name == "depth":
                if not isinstance(network.mono, DepthAnythingFeatures):
                    continue
                found[field.name] = load_depth_anything(network.mono, source)
            else:
                found[field.name] = load_trunk(network.trunk, source)
        except CheckpointError as error:
            raise CheckpointError(f"{field.name} weights: {error}") from error
    rows = {part: _row(report) for part, report in found.items()}
    theirs = sorted({f"{row['licence'] or 'not stated'} ({part})" for part, row in rows.items()})
    network.provenance |= {
        RECORD: json.dumps(rows, sort_keys=True),
        "gapmes.licence": f"{WEIGHTS_LICENCE} for what was trained; frozen parts: {', '.join(theirs)}",
    }
    return found


def _row(report: Fit) -> dict[str, str]:
    names = ("path", "sha256", "recognised", "layout", "licence", "repository", "commit")
    return {name: getattr(report, name) for name in names}
