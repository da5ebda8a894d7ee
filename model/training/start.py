"""What a run starts from, random weights or a checkpoint's, and what its own checkpoints record of that."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

from ..checkpoint import load_checkpoint, read_config, read_metadata
from ..config import ModelConfig
from ..network import GaPMeS
from ..weights_file import CheckpointError, file_sha256
from .differences import differences
from .recipe import Recipe

BEGUN = "gapmes.begun_from"  # sha256 of the checkpoint, or which random weights
SEEDS = "gapmes.seeds"  # of the recipes that the weights were trained by, that of the run before it too


def started(config: ModelConfig, recipe: Recipe, initial: Path | None) -> GaPMeS:
    """The network that a run starts from, which records that in its checkpoints; random weights are torch's next ones.

    Raises `CheckpointError` where `initial` has another configuration.
    """
    if initial is None:
        model, begun, before = GaPMeS(config), f"random weights of seed {recipe.seed}", set[int]()
    else:
        check_start(initial, config)
        model, begun, before = load_checkpoint(initial), file_sha256(initial), seeds_of(read_metadata(initial))
    model.provenance |= {BEGUN: begun, SEEDS: seeds_text({*before, recipe.seed})}
    return model


def check_start(path: Path, config: ModelConfig) -> None:
    """Raises `CheckpointError` unless the file is a checkpoint of this configuration."""
    found = read_config(path)
    if found != config:
        raise CheckpointError(
            f"{path} has another configuration than this run: {differences(asdict(found), asdict(config))}; "
            "give the preset and the switches that it was trained with"
        )


def seeds_of(metadata: Mapping[str, str]) -> set[int]:
    """The seeds that a checkpoint was trained by; empty where it does not say."""
    return {int(seed) for seed in metadata.get(SEEDS, "").split(",") if seed.isdecimal()}


def seeds_text(seeds: set[int]) -> str:
    """Inverse of `seeds_of`."""
    return ",".join(map(str, sorted(seeds)))
