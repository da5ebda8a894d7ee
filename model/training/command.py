"""Train a preset from scratch on generated scenes; an interrupted run goes on where it was."""

from __future__ import annotations

import argparse
import logging
import sys
from dataclasses import replace
from pathlib import Path

import torch

from ..config import PRESETS, ModelConfig, preset
from .loop import train
from .recipe import Recipe
from .run_folder import WEIGHTS
from .workers import Worker, run_workers

# a preset with frozen backbones would freeze random ones: it needs pretrained weights first
TRAINABLE = sorted(name for name, config in PRESETS.items() if not config.freeze_vits)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m gapmes.model.training", description=__doc__)
    parser.add_argument("out", type=Path, help="folder of the run; an interrupted run continues from it")
    parser.add_argument("--preset", choices=TRAINABLE, default="tiny")
    parser.add_argument("--steps", type=int, default=Recipe.steps)
    parser.add_argument("--seed", type=int, default=Recipe.seed)
    parser.add_argument("--processes", type=int, default=1, help="share the scenes of each step, at most 2 (default 1)")
    parser.add_argument("--threads", type=int, default=1, help="per process; one is fastest on shared cores")
    parser.add_argument("--device", default="auto", help="cpu, cuda, or auto: cuda when there is one")
    parser.add_argument("--validate-every", type=int, default=250, metavar="STEPS")
    for switch in ("without-depth", "without-experts", "without-tasks"):
        parser.add_argument(f"--{switch}", action="store_true", help="ablation")
    options = parser.parse_args(arguments)
    config = preset(
        options.preset,
        without_depth=options.without_depth,
        without_experts=options.without_experts,
        without_tasks=options.without_tasks,
    )
    recipe = replace(Recipe(), steps=options.steps, seed=options.seed)
    device = options.device
    if device == "auto":
        device = "cuda" if torch.cuda.is_available() else "cpu"
    run_workers(options.processes, options.threads, _train, config, recipe, options.out, options.validate_every, device)
    return 0


def _train(worker: Worker, config: ModelConfig, recipe: Recipe, folder: Path, validate_every: int, device: str) -> None:
    level = logging.INFO if worker.leads else logging.WARNING
    logging.basicConfig(level=level, format="%(asctime)s %(message)s", stream=sys.stderr)
    train(config, recipe, folder, validate_every=validate_every, device=device, worker=worker)
    logging.getLogger(__name__).info("weights: %s", folder / WEIGHTS)
