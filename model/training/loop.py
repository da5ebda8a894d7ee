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

from ..config import ModelConfig
from ..network import GaPMeS
from ..overflow import overflow
from ..pretrained.backbones import RECORD, BackboneSources, load_backbones
from ..weights_file import file_sha256
from .ahead import drawn_steps
from .precision import bfloat16_is_fast, use_bfloat16
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
from .start import started
from .step import TensorBatch, training_loss
from .step_scenes import StepScenes
from .validation import validate, validation_batches
from .workers import Worker

log = logging.getLogger(__name__)

SAVE_SECONDS = 120.0  # between two states: what an interrupt can cost
VALIDATION_SIZE = 128  # px
STEPS, SKIPPED = "steps", "skipped"  # counts among the sums of what the log gives means of


def train(
    config: ModelConfig,
    recipe: Recipe,
    folder: Path,
    *,
    validate_every: int = 250,
    validation_scenes: int = 12,
    save_seconds: float = SAVE_SECONDS,
    device: torch.device | str = "cpu",
    worker: Worker = Worker(),  # noqa: B008 - a frozen value
    backbones: BackboneSources | None = None,
    initial: Path | None = None,
    loaders: int = 0,
    listener: Listener = silent,
) -> GaPMeS:
    """Run the recipe to its end in `folder`, or continue the run that is there; returns the averaged weights.

    All random numbers of a step follow from (seed, step, worker), so that a resumed run repeats an uninterrupted one.

    Args:
        backbones: published weights for the frozen parts of a preset that has them.
        initial: checkpoint of this configuration to start from, frozen parts included, instead of random weights.
        worker: this process among those that divide the scenes of each step; only the first returns the average.
        loaders: number of processes, for each worker, that generate scenes ahead; changes nothing but the time.
        listener: is called at every step.

    Raises:
        Refused: the workers cannot share the scenes evenly, `folder` holds another run (recipe, start, kind of device,
            number of workers or threads, ...), or its state or log is damaged.
        CheckpointError: `initial` has another configuration.
        ValueError: an interval or a number of scenes below 1; both `backbones` and `initial`.
    """
    for name, value in (("validate_every", validate_every), ("validation_scenes", validation_scenes)):
        if value < 1:
            raise ValueError(f"{name} is {value}, need at least 1")
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
    model = started(config, recipe, initial)
    fits = {} if backbones is None else load_backbones(model, backbones)
    for part, report in fits.items():
        log.info("%s: %s: %s", part, report.path, "; ".join(report.summary()))
    model = model.to(device).train()
    frozen = [p for p in model.parameters() if not p.requires_grad]
    average = copy.deepcopy(model, {id(p): p for p in frozen}).requires_grad_(False)  # frozen parts are shared
    bfloat16 = bfloat16_is_fast(device)
    if bfloat16:
        use_bfloat16(model)
    trained = [p for p in model.parameters() if p.requires_grad]
    optimiser = torch.optim.AdamW(trained, lr=recipe.learning_rate, betas=(0.9, 0.98), weight_decay=recipe.weight_decay)
    identity: dict[str, str | None] = {
        "revision": REVISION,
        "config": config.to_json(),
        "recipe": json.dumps(asdict(recipe), sort_keys=True),
        "backbones": _sums(model.provenance.get(RECORD)),  # the state lacks the frozen parts
        "initial": None if initial is None else file_sha256(initial),
        "device": torch.device(device).type,  # the gates' noise depends on it
        "precision": "bfloat16" if bfloat16 else "float32",
        "process count": str(worker.count),  # each draws its own noise, and whether evidence is withheld
        "thread count": str(torch.get_num_threads()),  # it decides the order of summation
    }
    start, seconds, sums = restore_state(folder, identity, model, average, optimiser)
    held_out: dict[str, list[TensorBatch]] = {}
    if worker.leads:
        forget_rows_after(folder, start)
        for part, report in fits.items():
            report.write(folder / f"{part}.checkpoint.json")
    if worker.leads and start < recipe.steps:
        held_out = {
            "wide": validation_batches(VALIDATION_SIZE, validation_scenes, (0.18, 0.5)),
            "narrow": validation_batches(VALIDATION_SIZE, max(1, validation_scenes // 2), (0.06, 0.15)),
        }
    counts = model.trainable_parameters(), sum(p.numel() for p in model.parameters())
    log.info("%d of %d parameters trained, step %d of %d", *counts, start, recipe.steps)
    clock = last_save = time.monotonic()
    steps = range(start, recipe.steps)
    with closing(drawn_steps(recipe, steps, worker, loaders)) as coming:
        for step in steps:
            rate, parts = _step(model, optimiser, trained, recipe, step, next(coming), worker)  # frees the batch
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
    if worker.leads and not (folder / STATE).is_file():  # zero steps: mark the folder as this run's
        save_state(folder, {**identity, "step": start, "seconds": seconds, "sums": sums}, model, average, optimiser)
    elif worker.leads:
        save_weights(folder, average, recipe.steps)
    return average.eval()


def _sums(record: str | None) -> str | None:
    """The sha256 of the weights of each frozen part, whatever their files are called."""
    if record is None:
        return None
    return json.dumps({part: row["sha256"] for part, row in json.loads(record).items()}, sort_keys=True)


def _step(
    model: GaPMeS,
    optimiser: torch.optim.Optimizer,
    trained: list[torch.nn.Parameter],
    recipe: Recipe,
    step: int,
    scenes: StepScenes,
    worker: Worker,
) -> tuple[float, dict[str, float]]:
    """One update of the weights; the learning rate, and what to add up for the log.

    A step whose loss or gradient is not finite, in any process, changes no weights, and only its number is logged.
    """
    rate = recipe.learning_rate_at(step)
    for group in optimiser.param_groups:
        group["lr"] = rate
    torch.manual_seed(scenes.torch_seed)
    if model.mixture.gates is not None:
        model.mixture.gates.noise_scale = recipe.noise_scale_at(step)
    model.depth.withheld = scenes.withheld
    loss, parts = _loss(model, scenes.batch.to(trained[0].device), recipe, step)
    optimiser.zero_grad(set_to_none=True)
    if torch.isfinite(loss):
        loss.backward()
    else:  # its gradient may be finite; a NaN in the mean gradient makes all processes skip the step
        trained[0].grad = torch.full_like(trained[0], math.nan)
    worker.average_gradients(trained)
    norm = torch.nn.utils.clip_grad_norm_(trained, recipe.clip)
    if not torch.isfinite(norm):
        return rate, {STEPS: 1.0, SKIPPED: 1.0}
    optimiser.step()
    return rate, {**parts, "gradient_norm": float(norm), STEPS: 1.0}


def _loss(model: GaPMeS, batch: TensorBatch, recipe: Recipe, step: int) -> tuple[Tensor, dict[str, float]]:
    """The loss and its parts; raises `Refused` if the network overflows: damaged initial weights, or divergence."""
    try:
        return training_loss(model, batch, recipe, step)
    except (IndexError, RuntimeError, ValueError) as error:
        given = (batch.images, batch.intrinsics, batch.poses, batch.near_far)
        if found := overflow(model, lambda: model(*given)):
            raise Refused(
                f"step {step + 1}: {found}; the initial weights are damaged or the run has diverged: use a new folder, "
                "with other weights or another seed"
            ) from error
        raise


@torch.no_grad()
def _average(average: GaPMeS, model: GaPMeS, decay: float) -> None:
    for mean, value in zip(average.parameters(), model.parameters(), strict=True):
        if value.requires_grad:
            mean.lerp_(value, 1 - decay)


def _means(sums: dict[str, float]) -> dict[str, float]:
    """Means over the steps that were not skipped, and the share of those that were, if any."""
    counts = {STEPS: sums.get(STEPS, 0.0), SKIPPED: sums.get(SKIPPED, 0.0)}
    taken = counts[STEPS] - counts[SKIPPED]
    means = {key: round(value / taken, 5) for key, value in sums.items() if key not in counts}
    return means | ({SKIPPED: round(counts[SKIPPED] / counts[STEPS], 5)} if counts[SKIPPED] else {})


def _report(
    folder: Path,
    step: int,
    recipe: Recipe,
    elapsed: float,
    rate: float,
    sums: dict[str, float],
    figures: dict[str, dict[str, object]],
) -> None:
    means = _means(sums)
    if "mse" in means:
        means["psnr"] = round(-10 * math.log10(max(means.pop("mse"), 1e-10)), 3)
    row = {"step": step, "minutes": round(elapsed / 60, 2), "rate": rate, "train": means, "validation": figures}
    append_row(folder, row)
    wide, narrow = figures["wide"], figures["narrow"]
    log.info(
        "step %d/%d  %.1f min  train %.2f dB  wide %.2f dB (copy %.2f)  narrow %.2f dB  depth %.4f  holes %.2f%%%s",
        step,
        recipe.steps,
        elapsed / 60,
        means.get("psnr", float("nan")),
        wide["psnr"],
        wide["copy_psnr"],
        narrow["psnr"],
        wide["depth_error"],
        100 * float(wide["holes"]),  # type: ignore[arg-type]
        f"  skipped {means[SKIPPED]:.1%} of the steps" if SKIPPED in means else "",
    )
