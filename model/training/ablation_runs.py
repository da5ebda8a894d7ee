"""The variants of the ablation study, the budget that they share, and one run: trained, scored, kept in a folder."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gapmes.service.process.disk import replace_file

from ..checkpoint import load_checkpoint
from ..config import ModelConfig, preset
from ..network import GaPMeS
from .ablation_table import COMPLETE, SAME_SCENE_DB, Scores
from .differences import differences
from .log_rows import read_rows
from .loop import train
from .lpips import Lpips
from .precision import bfloat16_is_fast
from .recipe import Phase, Recipe
from .run_folder import LOG, WEIGHTS
from .step import TensorBatch
from .training_run import TrainingRun
from .validation import validate, validation_batches

# fields of the configuration that a variant changes; the complete model has tau 0.8, six experts and top 2
VARIANTS: dict[str, dict[str, object]] = {
    COMPLETE: {},
    "without-depth": {"without_depth": True},
    "without-experts": {"without_experts": True},
    "without-tasks": {"without_tasks": True},
    "tau-0.4": {"temperature": 0.4},
    "tau-0.6": {"temperature": 0.6},
    "experts-4": {"experts": 4},
    "experts-8": {"experts": 8},
    "top-1": {"top_k": 1},
}
SCORES = "scores.json"
AGAIN = "remove the file, and the run is scored again"
WIDE = (0.18, 0.5)  # baseline of the validation scenes, in units of the scene's median depth
FIGURES = ("psnr", "ssim", "depth_error", "copy_psnr")
LPIPS = "lpips"  # one more figure, if weights for it are given
SAME_WEIGHTS_DB = (
    0.05  # between two scorings of one run: other threads round differently, which may route a patch to other experts
)


@dataclass(frozen=True)
class Budget:
    """What all variants have in common."""

    steps: int = 600
    size: int = 64  # px, in training and validation
    training_scenes: int = 4  # per step
    validation_scenes: int = 64
    log_rows: int = 12  # per run

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if value < 1:
                raise ValueError(f"{name} is {value}, need at least 1")

    def recipe(self, seed: int) -> Recipe:
        """One phase with two views at one size; no near occluders, no targets off the path, no withheld evidence; a
        sixth of the steps is warm-up."""
        phases = (Phase(1.0, (self.size,), self.training_scenes, (2,), (0.06, 0.6)),)
        warm_up = max(1, self.steps // 6)
        plain = replace(Recipe(), close_share=0.0, aside=0.0, withheld_until=0.0)
        return replace(plain, steps=self.steps, seed=seed, warm_up=warm_up, phases=phases)

    def batches(self) -> list[TensorBatch]:
        """The validation scenes, one to a batch, the same for every variant and seed."""
        return validation_batches(self.size, self.validation_scenes, WIDE)


@dataclass(frozen=True)
class Run:
    """One variant trained with one seed in a folder of its own."""

    name: str
    seed: int
    budget: Budget
    folder: Path

    @property
    def config(self) -> ModelConfig:
        return preset("tiny", **VARIANTS[self.name])

    def scores(self) -> Scores | None:
        """What an earlier call left; None when the run is not finished.

        Raises `ValueError` when the folder holds a run of another configuration, recipe or budget, and for a file that
        is damaged.
        """
        path = self.folder / SCORES
        if not path.is_file():
            return None
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
            kept = {key: found[key] for key in self._identity()}
            names = [*FIGURES, *([LPIPS] if LPIPS in found["scores"] else [])]
            figures = {name: np.array(found["scores"][name], np.float64) for name in names}
            scores = Scores(
                int(found["parameters"]), float(found["minutes"]), **figures, lpips_weights=found.get("lpips_weights")
            )
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{path} holds no scores of a run: {error!r}; {AGAIN}") from error
        for key, asked in self._identity().items():
            if kept[key] != asked:
                raise ValueError(f"{path} is of another {key}: {differences(kept[key], asked)}; use a new folder")
        for name, values in figures.items():
            if values.shape != (self.budget.validation_scenes,):
                raise ValueError(
                    f"{path} has {name} of shape {values.shape}, need one number for each of the "
                    f"{self.budget.validation_scenes} scenes; {AGAIN}"
                )
        return scores

    def step(self) -> int:
        """The last step in the log, 0 when there is none yet."""
        path = self.folder / LOG
        rows = read_rows(path) if path.is_file() else []
        return int(rows[-1]["step"]) if rows else 0

    def execute(self, batches: Sequence[TensorBatch], lpips: Lpips | None = None) -> Scores:
        """Train, going on where a killed run stopped, and score; raises `ValueError` as `train` does."""
        every = max(1, self.budget.steps // self.budget.log_rows)
        # the small validation of the log is for watching only, the scores come from `batches`
        recipe = self.budget.recipe(self.seed)
        model = train(TrainingRun(self.config, recipe, self.folder, validate_every=every, validation_scenes=2))
        scores = scene_scores(model, batches, float(read_rows(self.folder / LOG)[-1]["minutes"]), lpips)
        self._keep(scores)
        return scores

    def add_lpips(self, scores: Scores, batches: Sequence[TensorBatch], lpips: Lpips) -> Scores:
        """Add LPIPS to the scores of a finished run, from the weights that it left; nothing is trained.

        Raises `ValueError` when these weights do not have the PSNR that the scores tell, and `CheckpointError` when
        they are gone or damaged.
        """
        path = self.folder / WEIGHTS
        again = scene_scores(load_checkpoint(path), batches, scores.minutes, lpips)
        for field, tolerance in (("copy_psnr", SAME_SCENE_DB), ("psnr", SAME_WEIGHTS_DB)):
            before, now = getattr(scores, field), getattr(again, field)
            if (different := np.abs(now - before) > tolerance).any():
                scene = int(different.argmax())
                raise ValueError(
                    f"{path} has {field} {now[scene]:.2f} dB in scene {scene}, {SCORES} says {before[scene]:.2f} dB; "
                    "was the code changed since? use a new folder"
                )
        scores = replace(scores, lpips=again.lpips, lpips_weights=again.lpips_weights)
        self._keep(scores)
        return scores

    def _keep(self, scores: Scores) -> None:
        body = {
            **self._identity(),
            "parameters": scores.parameters,
            "minutes": scores.minutes,
            "scores": by_scene(scores),
            "lpips_weights": scores.lpips_weights,
        }
        replace_file(self.folder / SCORES, (json.dumps(body, allow_nan=False) + "\n").encode())

    def _identity(self) -> dict[str, Any]:
        parts = {
            "config": asdict(self.config),
            "recipe": asdict(self.budget.recipe(self.seed)),
            "budget": asdict(self.budget),
            "precision": {"bfloat16": bfloat16_is_fast("cpu")},
        }
        return json.loads(json.dumps(parts))  # tuples as JSON gives them back


def run_in(out: Path, name: str, seed: int, budget: Budget) -> Run:
    """The run of a variant below `out`."""
    return Run(name, seed, budget, out / f"{name}-seed{seed}")


def scene_scores(model: GaPMeS, batches: Sequence[TensorBatch], minutes: float, lpips: Lpips | None = None) -> Scores:
    """Figures scene by scene, so that variants can be compared on the same ones; every batch holds one scene."""
    rows = [validate(model, [batch], lpips) for batch in batches]
    names = [*FIGURES, *([LPIPS] if lpips is not None else [])]
    figures = {name: np.array([row[name] for row in rows], np.float64) for name in names}
    weights = None if lpips is None else lpips.fingerprint
    return Scores(sum(p.numel() for p in model.parameters()), minutes, **figures, lpips_weights=weights)


def by_scene(scores: Scores) -> dict[str, list[float]]:
    """Every figure that the scores hold, one number per scene."""
    figures = {name: getattr(scores, name) for name in (*FIGURES, LPIPS)}
    return {name: values.tolist() for name, values in figures.items() if values is not None}
