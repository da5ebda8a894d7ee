"""The training loop: resumes after a kill at any moment, logs JSON lines, validates as it goes."""

from __future__ import annotations

import copy
import json
import logging
import math
import time
from contextlib import closing, nullcontext
from dataclasses import asdict
from pathlib import Path

import torch
from torch import Tensor

from gapmes.service.progress import Listener, Stage, silent

from ..checkpoint import load_checkpoint, read_config
from ..config import ModelConfig
from ..network import GaPMeS
from ..overflow import overflow
from ..pretrained.backbones import RECORD, BackboneSources, load_backbones
from ..weights_file import CheckpointError, file_sha256
from .ahead import drawn_steps
from .differences import differences
from .precision import coarse_pays, compute_coarsely
from .recipe import Recipe
from .run_folder import (
    REVISION,
    STATE,
    Refused,
    append_row,
    claimed,
    forget_rows_after,
    restore_state,
    save_state,
    save_weights,
)
from .step import TensorBatch, training_loss
from .step_scenes import StepScenes
from .validation import validate, validation_batches
from .workers import Worker

log = logging.getLogger(__name__)


def train(
    config: ModelConfig,
    recipe: Recipe,
    folder: Path,
    *,
    validate_every: int = 250,
    validation_scenes: int = 12,
    save_seconds: float = 120.0,
    device: torch.device | str = "cpu",
    worker: Worker = Worker(),  # noqa: B008 - a frozen value
    backbones: BackboneSources | None = None,
    initial: Path | None = None,
    loaders: int = 0,
    listener: Listener = silent,
) -> GaPMeS:
    """Run the recipe to its end in `folder` and return the averaged weights; continues from what is there.

    Every random number of a step comes from (seed, step, worker), so a resumed run sees what an unbroken one would
    have seen. `backbones` gives the frozen parts of a preset that has them; `initial` is a checkpoint of this
    configuration to start from instead of from random numbers, frozen parts and all; as many processes as `loaders`
    draw scenes ahead, of each worker, which changes nothing but the time; `listener` hears of every step.
    Several workers divide each step's scenes between them: raises `Refused` when they cannot, in a folder whose run
    is another one or has another number of them or of their threads, and in one whose state or log is damaged. Raises
    `CheckpointError` for a checkpoint of another configuration.
    """
    if backbones is not None and initial is not None:
        raise ValueError("backbones: the weights to start from carry the frozen parts already; give one of both")
    if uneven := recipe.not_shared_by(worker.count):
        raise Refused(f"processes: {uneven}")
    with claimed(folder) if worker.leads else nullcontext():
        return _run(
            config,
            recipe,
            folder,
            validate_every,
            validation_scenes,
            save_seconds,
            device,
            worker,
            backbones,
            initial,
            loaders,
            listener,
        )


def _run(
    config: ModelConfig,
    recipe: Recipe,
    folder: Path,
    validate_every: int,
    validation_scenes: int,
    save_seconds: float,
    device: torch.device | str,
    worker: Worker,
    backbones: BackboneSources | None,
    initial: Path | None,
    loaders: int,
    listener: Listener,
) -> GaPMeS:
    torch.manual_seed(recipe.seed)
    model = GaPMeS(config) if initial is None else _started_from(initial, config)
    fits = {} if backbones is None else load_backbones(model, backbones)
    for part, report in fits.items():
        log.info("%s: %s: %s", part, report.path, "; ".join(report.summary()))
    model = model.to(device).train()
    frozen = [p for p in model.parameters() if not p.requires_grad]
    average = copy.deepcopy(model, {id(p): p for p in frozen}).requires_grad_(False)  # shares what does not change
    coarse = coarse_pays(device)
    if coarse:
        compute_coarsely(model)
    trained = [p for p in model.parameters() if p.requires_grad]
    optimiser = torch.optim.AdamW(trained, lr=recipe.learning_rate, betas=(0.9, 0.98), weight_decay=recipe.weight_decay)
    identity: dict[str, str | None] = {
        "revision": REVISION,
        "config": config.to_json(),
        "recipe": json.dumps(asdict(recipe), sort_keys=True),
        "backbones": _sums(model.provenance.get(RECORD)),  # not in the state: other frozen parts are another run
        "initial": None if initial is None else file_sha256(initial),
        "precision": "bfloat16" if coarse else "float32",
        "process count": str(worker.count),  # each draws its own noise, and what is withheld
        "thread count": str(torch.get_num_threads()),  # sums in another order round otherwise
    }
    start, seconds, sums = restore_state(folder, identity, model, average, optimiser)
    held_out: dict[str, list[TensorBatch]] = {}
    if worker.leads:
        forget_rows_after(folder, start)
        for part, report in fits.items():
            report.write(folder / f"{part}.checkpoint.json")
    if worker.leads and start < recipe.steps:
        held_out = {
            "wide": validation_batches(128, validation_scenes, (0.18, 0.5)),
            "narrow": validation_batches(128, max(1, validation_scenes // 2), (0.06, 0.15)),
        }
    counts = model.trainable_parameters(), sum(p.numel() for p in model.parameters())
    log.info("%d of %d parameters trained, step %d of %d", *counts, start, recipe.steps)
    clock = last_save = time.monotonic()
    steps = range(start, recipe.steps)
    with closing(drawn_steps(recipe, steps, worker, loaders)) as coming:
        for step in steps:
            rate, parts = _step(model, optimiser, trained, recipe, step, next(coming), worker)  # kept by nobody
            if not worker.leads:
                continue
            listener(Stage("train", step + 1, recipe.steps))
            _average(average, model, min(recipe.ema, (step + 1) / (step + 20)))
            for key, value in parts.items():
                sums[key] = sums.get(key, 0.0) + value
            now = time.monotonic()
            last = step + 1 == recipe.steps
            if last or (step + 1) % validate_every == 0:
                elapsed = seconds + now - clock
                figures = {name: validate(average, batches) for name, batches in held_out.items()}
                _report(folder, step + 1, recipe, elapsed, rate, sums, figures)
                sums = {}
            if last or now - last_save > save_seconds:
                elapsed = seconds + time.monotonic() - clock
                progress: dict[str, object] = {**identity, "step": step + 1, "seconds": elapsed, "sums": sums}
                save_state(folder, progress, model, average, optimiser)
                last_save = time.monotonic()
    if worker.leads and not (folder / STATE).is_file():  # of no steps at all, and yet this run's folder
        save_state(folder, {**identity, "step": start, "seconds": seconds, "sums": sums}, model, average, optimiser)
    elif worker.leads:
        save_weights(folder, average, recipe.steps)
    return average.eval()


def check_start(path: Path, config: ModelConfig) -> None:
    """Raises `CheckpointError` unless the file is a checkpoint of this configuration."""
    found = read_config(path)
    if found != config:
        raise CheckpointError(
            f"{path} has another configuration than this run: {differences(asdict(found), asdict(config))}; "
            "give the preset and the switches that it was trained with"
        )


def _sums(record: str | None) -> str | None:
    """Which weights the frozen parts have, wherever they lay and whatever they were called."""
    if record is None:
        return None
    return json.dumps({part: row["sha256"] for part, row in json.loads(record).items()}, sort_keys=True)


def _started_from(path: Path, config: ModelConfig) -> GaPMeS:
    check_start(path, config)
    return load_checkpoint(path)


def _step(
    model: GaPMeS,
    optimiser: torch.optim.Optimizer,
    trained: list[torch.nn.Parameter],
    recipe: Recipe,
    step: int,
    scenes: StepScenes,
    worker: Worker,
) -> tuple[float, dict[str, float]]:
    rate = recipe.learning_rate_at(step)
    for group in optimiser.param_groups:
        group["lr"] = rate
    torch.manual_seed(scenes.torch_seed)
    if model.mixture.gates is not None:
        model.mixture.gates.noise_scale = recipe.noise_scale_at(step)
    model.depth.withheld = scenes.withheld
    loss, parts = _loss(model, scenes.batch.to(trained[0].device), recipe, step)
    optimiser.zero_grad(set_to_none=True)
    loss.backward()
    worker.average_gradients(trained)
    norm = torch.nn.utils.clip_grad_norm_(trained, recipe.clip)
    parts["steps"] = 1.0
    if torch.isfinite(norm):
        optimiser.step()
        parts["gradient_norm"] = float(norm)
    else:
        parts["skipped"] = 1.0
    return rate, parts


def _loss(model: GaPMeS, batch: TensorBatch, recipe: Recipe, step: int) -> tuple[Tensor, dict[str, float]]:
    """Raises `Refused` where the network overflows, which frozen parts may bring along and a run may come to."""
    try:
        return training_loss(model, batch, recipe, step)
    except (IndexError, RuntimeError, ValueError) as error:
        given = (batch.images, batch.intrinsics, batch.poses, batch.near_far)
        if found := overflow(model, lambda: model(*given)):
            raise Refused(
                f"step {step + 1}: {found}; what it began with is damaged or the run has diverged: use a new folder, "
                "with other weights or another seed"
            ) from error
        raise


@torch.no_grad()
def _average(average: GaPMeS, model: GaPMeS, decay: float) -> None:
    for mean, value in zip(average.parameters(), model.parameters(), strict=True):
        if value.requires_grad:
            mean.lerp_(value, 1 - decay)


def _report(
    folder: Path,
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
    append_row(folder, row)
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
