"""The training loop: resumes after a kill at any moment, logs JSON lines, validates as it goes."""

from __future__ import annotations

import copy
import json
import logging
import math
import time
from contextlib import closing, nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from torch import Tensor

from gapmes.service.progress import Listener, Stage, silent

from ..network import GaPMeS
from ..overflow import overflow
from ..pretrained.backbones import RECORD, load_backbones
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
from .training_run import TrainingRun
from .validation import validate, validation_batches
from .workers import Worker

log = logging.getLogger(__name__)

VALIDATION_SIZE = 128  # px
STEPS, SKIPPED = "steps", "skipped"  # counts among the sums of what the log gives means of


@dataclass(frozen=True)
class _Networks:
    """What training changes."""

    model: GaPMeS
    average: GaPMeS  # of the weights; frozen parts are shared
    trained: list[torch.nn.Parameter]  # those of the model that are not frozen
    optimiser: torch.optim.Optimizer


def train(
    run: TrainingRun,
    *,
    worker: Worker = Worker(),  # noqa: B008 - a frozen value
    listener: Listener = silent,
) -> GaPMeS:
    """Run the recipe to its end in the run's folder, or continue the run that is there; returns the averaged weights.

    All random numbers of a step follow from (seed, step, worker), so that a resumed run repeats an uninterrupted one.

    Args:
        worker: this process among those that divide the scenes of each step; only the first returns the average.
        listener: is called at every step.

    Raises:
        Refused: the workers cannot share the scenes evenly, the folder holds another run (recipe, start, kind of
            device, number of workers or threads, ...), or its state or log is damaged.
        CheckpointError: the weights to start from have another configuration.
    """
    if uneven := run.recipe.not_shared_by(worker.count):
        raise Refused(f"processes: {uneven}")
    with claimed(run.folder) if worker.leads else nullcontext():
        return _run(run, worker, listener)


def _run(run: TrainingRun, worker: Worker, listener: Listener) -> GaPMeS:
    recipe, folder = run.recipe, run.folder
    torch.manual_seed(recipe.seed)
    model = started(run.config, recipe, run.initial)
    fits = {} if run.backbones is None else load_backbones(model, run.backbones)
    for part, report in fits.items():
        log.info("%s: %s: %s", part, report.path, "; ".join(report.summary()))
    networks = _networks(model, run)
    model, average = networks.model, networks.average
    identity = _identity(run, worker, model)
    start, seconds, sums = restore_state(folder, identity, model, average, networks.optimiser)
    if worker.leads:
        forget_rows_after(folder, start)
        for part, report in fits.items():
            report.write(folder / f"{part}.checkpoint.json")
    held_out = _held_out(run.validation_scenes) if worker.leads and start < recipe.steps else {}
    counts = model.trainable_parameters(), sum(p.numel() for p in model.parameters())
    log.info("%d of %d parameters trained, step %d of %d", *counts, start, recipe.steps)

    def save(step: int, elapsed: float) -> None:
        progress: dict[str, object] = {**identity, "step": step, "seconds": elapsed, "sums": sums}
        save_state(folder, progress, model, average, networks.optimiser)

    clock = last_save = time.monotonic()
    steps = range(start, recipe.steps)
    with closing(drawn_steps(recipe, steps, worker, run.loaders)) as coming:
        for step in steps:
            rate, parts = _step(networks, recipe, step, next(coming), worker)  # frees the batch
            if not worker.leads:
                continue
            listener(Stage("train", step + 1, recipe.steps))
            _average(average, model, min(recipe.ema, (step + 1) / (step + 20)))
            for key, value in parts.items():
                sums[key] = sums.get(key, 0.0) + value
            now = time.monotonic()
            last = step + 1 == recipe.steps
            if last or (step + 1) % run.validate_every == 0:
                elapsed = seconds + now - clock
                figures = {name: validate(average, batches) for name, batches in held_out.items()}
                _report(folder, step + 1, recipe, elapsed, rate, sums, figures)
                sums = {}
            if last or now - last_save > run.save_seconds:
                save(step + 1, seconds + time.monotonic() - clock)
                last_save = time.monotonic()
    if worker.leads and not (folder / STATE).is_file():  # zero steps: mark the folder as this run's
        save(start, seconds)
    elif worker.leads:
        save_weights(folder, average, recipe.steps)
    return average.eval()


def _networks(model: GaPMeS, run: TrainingRun) -> _Networks:
    """The network on the run's device, ready to train, and its average, which stays in float32."""
    model = model.to(run.device).train()
    frozen = [p for p in model.parameters() if not p.requires_grad]
    average = copy.deepcopy(model, {id(p): p for p in frozen}).requires_grad_(False)
    if bfloat16_is_fast(run.device):
        use_bfloat16(model)
    trained = [p for p in model.parameters() if p.requires_grad]
    rate, decay = run.recipe.learning_rate, run.recipe.weight_decay
    return _Networks(
        model, average, trained, torch.optim.AdamW(trained, lr=rate, betas=(0.9, 0.98), weight_decay=decay)
    )


def _identity(run: TrainingRun, worker: Worker, model: GaPMeS) -> dict[str, str | None]:
    """What a run that goes on from a state must have in common with the one that saved it."""
    return {
        "revision": REVISION,
        "config": run.config.to_json(),
        "recipe": json.dumps(asdict(run.recipe), sort_keys=True),
        "backbones": _sums(model.provenance.get(RECORD)),  # the state lacks the frozen parts
        "initial": None if run.initial is None else file_sha256(run.initial),
        "device": torch.device(run.device).type,  # the gates' noise depends on it
        "precision": "bfloat16" if bfloat16_is_fast(run.device) else "float32",
        "process count": str(worker.count),  # each draws its own noise, and whether evidence is withheld
        "thread count": str(torch.get_num_threads()),  # it decides the order of summation
    }


def _held_out(scenes: int) -> dict[str, list[TensorBatch]]:
    """The scenes that validation looks at, by how far apart their inputs are."""
    return {
        "wide": validation_batches(VALIDATION_SIZE, scenes, (0.18, 0.5)),
        "narrow": validation_batches(VALIDATION_SIZE, max(1, scenes // 2), (0.06, 0.15)),
    }


def _sums(record: str | None) -> str | None:
    """The sha256 of the weights of each frozen part, whatever their files are called."""
    if record is None:
        return None
    return json.dumps({part: row["sha256"] for part, row in json.loads(record).items()}, sort_keys=True)


def _step(
    networks: _Networks, recipe: Recipe, step: int, scenes: StepScenes, worker: Worker
) -> tuple[float, dict[str, float]]:
    """One update of the weights; the learning rate, and what to add up for the log.

    A step whose loss or gradient is not finite, in any process, changes no weights, and only its number is logged.
    """
    model, optimiser, trained = networks.model, networks.optimiser, networks.trained
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
