"""The training data of one step, which depends on recipe, step and worker alone and not on the generating process."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from .recipe import Recipe
from .scenes import SceneSampler
from .step import TensorBatch, to_tensors
from .workers import Worker


@dataclass(frozen=True)
class StepScenes:
    """A worker's share of the scenes of a step, and its random decisions."""

    batch: TensorBatch  # on the CPU, with the sensor noise of its inputs
    torch_seed: int  # of the noise on the gates
    withheld: bool  # whether the network gets no matching evidence


def draw_step(recipe: Recipe, step: int, worker: Worker) -> StepScenes:
    """The scenes of `worker` in this step: size, views and zoom are the step's, noise is the worker's own."""
    phase = recipe.phase(step)
    random = np.random.default_rng((recipe.seed, step))
    zoomed = bool(random.random() < recipe.zoom_share)
    size = phase.sizes[step % len(phase.sizes)] * (2 if zoomed else 1)
    scenes = phase.scenes // worker.count
    sampler = SceneSampler(int(random.integers(2**31)), "train", first=worker.rank * scenes)
    drawn = sampler.batch(
        scenes,
        phase.views[step % len(phase.views)],
        recipe.targets,
        size,
        baseline=phase.baseline,
        field_of_view=phase.field_of_view,
        close_share=recipe.close_share,
        aside=recipe.aside,
    )
    batch = to_tensors(drawn, zoomed=zoomed)
    noisy = random.random() < 0.5
    own = np.random.default_rng((recipe.seed, step, 1 + worker.rank))  # a last 0 would give the stream of `random`
    torch_seed = int(own.integers(2**62))
    if noisy:
        batch = add_noise(batch, recipe.input_noise, own)
    return StepScenes(batch, torch_seed, bool(own.random() < recipe.withheld_at(step)))


def add_noise(batch: TensorBatch, sigma: float, random: np.random.Generator) -> TensorBatch:
    """Sensor noise on the inputs alone."""
    noise = torch.from_numpy(random.normal(0, sigma, batch.images.shape).astype(np.float32))
    return replace(batch, images=(batch.images + noise).clamp(0, 1))
