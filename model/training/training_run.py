"""What a run trains, on what, where, and how often it is looked at and saved."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch

from ..config import ModelConfig
from ..pretrained.backbones import BackboneSources
from .recipe import Recipe

SAVE_SECONDS = 120.0  # between two states: what an interrupt can cost


@dataclass(frozen=True)
class TrainingRun:
    """A run as it was asked for; the same for all processes that share it."""

    config: ModelConfig
    recipe: Recipe
    folder: Path
    validate_every: int = 250  # steps
    validation_scenes: int = 12
    save_seconds: float = SAVE_SECONDS
    device: torch.device | str = "cpu"
    backbones: BackboneSources | None = None  # published weights for the frozen parts of a preset that has them
    initial: Path | None = None  # checkpoint of `config` to start from, frozen parts included, not from random weights
    loaders: int = 0  # processes, for each worker, that generate scenes ahead; they change nothing but the time

    def __post_init__(self) -> None:
        """Raises `ValueError` for an interval or a number of scenes below 1, and for both `backbones` and `initial`."""
        for name, value in (("validate_every", self.validate_every), ("validation_scenes", self.validation_scenes)):
            if value < 1:
                raise ValueError(f"{name} is {value}, need at least 1")
        if self.backbones is not None and self.initial is not None:
            raise ValueError("backbones: the weights to start from carry the frozen parts already; give one of both")
