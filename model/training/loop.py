"""The training loop: resumes after a kill at any moment, logs JSON lines, validates as it goes."""

from __future__ import annotations

import copy
import json
import logging
import math
import os
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch

from ..checkpoint import save_checkpoint
from ..config import ModelConfig
from ..network import GaPMeS
from .recipe import Recipe
from .scenes import SceneSampler
from .step import add_noise, to_tensors, training_loss
from .validation import validate, validation_batches

log = logging.getLogger(__name__)

STATE = "state.pt"
WEIGHTS = "weights.safetensors"
LOG = "log.jsonl"


def train(
    config: ModelConfig,
    recipe: Recipe,
    folder: Path,
    *,
    validate_every: int = 250,
    validation_scenes: int = 12,
    save_seconds: float = 120.0,
) -> GaPMeS:
    """Run the recipe to its end in `folder` and return the averaged weights; continues from what is there.

    Every random number of a step comes from (seed, step), so a resumed run sees what an unbroken one would have seen.
    """
    folder.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(recipe.seed)
    model = GaPMeS(config).train()
    average = copy.deepcopy(model).requires_grad_(False)
    trained = [p for p in model.parameters() if p.requires_grad]
    optimiser = torch.optim.AdamW(trained, lr=recipe.learning_rate, betas=(0.9, 0.98), weight_decay=recipe.weight_decay)
    identity = {"config": config.to_json(), "recipe": json.dumps(asdict(recipe), sort_keys=True)}
    start, seconds = _restore(folder / STATE, identity, model, average, optimiser)
    _forget_rows_after(folder / LOG, start)
    held_out = {
        "wide": validation_batches(128, validation_scenes, (0.18, 0.5)),
        "narrow": validation_batches(128, max(1, validation_scenes // 2), (0.06, 0.15)),
    }
    log.info("%d parameters, step %d of %d", model.trainable_parameters(), start, recipe.steps)
    clock = last_save = time.monotonic()
    sums: dict[str, float] = {}
    for step in range(start, recipe.steps):
        rate, parts = _step(model, optimiser, trained, recipe, step)
        _average(average, model, min(recipe.ema, (step + 1) / (step + 20)))
        for key, value in parts.items():
            sums[key] = sums.get(key, 0.0) + value
        now = time.monotonic()
        last = step + 1 == recipe.steps
        if last or (step + 1) % validate_every == 0:
            elapsed = seconds + now - clock
            figures = {name: validate(average, batches) for name, batches in held_out.items()}
            _report(folder / LOG, step + 1, recipe, elapsed, rate, sums, figures)
            sums = {}
        if last or now - last_save > save_seconds:
            progress = {**identity, "step": step + 1, "seconds": seconds + time.monotonic() - clock}
            _save(folder, progress, model, average, optimiser)
            last_save = time.monotonic()
    save_checkpoint(folder / WEIGHTS, average, extra={"gapmes.step": str(recipe.steps)})
    return average.eval()


def _step(
    model: GaPMeS, optimiser: torch.optim.Optimizer, trained: list[torch.nn.Parameter], recipe: Recipe, step: int
) -> tuple[float, dict[str, float]]:
    phase = recipe.phase(step)
    random = np.random.default_rng((recipe.seed, step))
    torch.manual_seed(int(random.integers(2**62)))
    rate = recipe.learning_rate_at(step)
    for group in optimiser.param_groups:
        group["lr"] = rate
    zoomed = bool(random.random() < recipe.zoom_share)
    size = phase.size * 2 if zoomed else phase.size
    sampler = SceneSampler(int(random.integers(2**31)), "train")
    views = phase.views[step % len(phase.views)]
    batch = to_tensors(sampler.batch(phase.scenes, views, recipe.targets, size, baseline=phase.baseline), zoomed=zoomed)
    if random.random() < 0.5:
        batch = add_noise(batch, recipe.input_noise, random)
    if model.mixture.gates is not None:
        model.mixture.gates.noise_scale = recipe.noise_scale_at(step)
    loss, parts = training_loss(model, batch, recipe, step)
    optimiser.zero_grad(set_to_none=True)
    loss.backward()
    norm = torch.nn.utils.clip_grad_norm_(trained, recipe.clip)
    parts["steps"] = 1.0
    if torch.isfinite(norm):
        optimiser.step()
        parts["gradient_norm"] = float(norm)
    else:
        parts["skipped"] = 1.0
    return rate, parts


@torch.no_grad()
def _average(average: GaPMeS, model: GaPMeS, decay: float) -> None:
    for mean, value in zip(average.parameters(), model.parameters(), strict=True):
        mean.lerp_(value, 1 - decay)


def _report(
    path: Path,
    step: int,
    recipe: Recipe,
    elapsed: float,
    rate: float,
    sums: dict[str, float],
    figures: dict[str, dict[str, object]],
) -> None:
    count = sums.pop("steps", 1.0)
    means = {key: round(value / count, 5) for key, value in sums.items()}
    if "mse" in means:
        means["psnr"] = round(-10 * math.log10(max(means.pop("mse"), 1e-10)), 3)
    row = {"step": step, "minutes": round(elapsed / 60, 2), "rate": rate, "train": means, "validation": figures}
    with path.open("a") as file:
        file.write(json.dumps(row) + "\n")
    wide, narrow = figures["wide"], figures["narrow"]
    log.info(
        "step %d/%d  %.1f min  train %.2f dB  wide %.2f dB (copy %.2f)  narrow %.2f dB  depth %.4f  holes %.2f%%",
        step,
        recipe.steps,
        elapsed / 60,
        means.get("psnr", float("nan")),
        wide["psnr"],
        wide["copy_psnr"],
        narrow["psnr"],
        wide["depth_error"],
        100 * float(wide["holes"]),  # type: ignore[arg-type]
    )


def _save(
    folder: Path,
    progress: dict[str, object],
    model: GaPMeS,
    average: GaPMeS,
    optimiser: torch.optim.Optimizer,
) -> None:
    """Everything that a later start needs, whole or not at all."""
    state = {
        **progress,
        "model": model.state_dict(),
        "average": average.state_dict(),
        "optimiser": optimiser.state_dict(),
    }
    part = folder / (STATE + ".part")
    torch.save(state, part)
    os.replace(part, folder / STATE)
    save_checkpoint(folder / WEIGHTS, average, extra={"gapmes.step": str(progress["step"])})


def _restore(
    path: Path, identity: dict[str, str], model: GaPMeS, average: GaPMeS, optimiser: torch.optim.Optimizer
) -> tuple[int, float]:
    """Step and seconds to go on from; raises `ValueError` when the folder holds a run of something else."""
    if not path.is_file():
        return 0, 0.0
    state = torch.load(path, weights_only=True)
    for key, value in identity.items():
        if state[key] != value:
            raise ValueError(
                f"{path} is of a run with another {key}: {state[key]}, asked for {value}; use a new folder"
            )
    model.load_state_dict(state["model"])
    average.load_state_dict(state["average"])
    optimiser.load_state_dict(state["optimiser"])
    return int(state["step"]), float(state["seconds"])


def _forget_rows_after(path: Path, step: int) -> None:
    """Drop log rows of steps that were lost with a kill and will be done again."""
    if path.is_file():
        rows = [line for line in path.read_text().splitlines() if json.loads(line)["step"] <= step]
        path.write_text("".join(row + "\n" for row in rows))
