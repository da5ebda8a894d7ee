"""`python -m gapmes.model.training OUT`: train the tiny preset from scratch on generated scenes, resumable."""

from __future__ import annotations

import argparse
import logging
import sys
from dataclasses import replace
from pathlib import Path

import numba
import torch

from ..config import PRESETS, preset
from .loop import WEIGHTS, train
from .recipe import Recipe

# a preset with frozen backbones would freeze random ones: it needs pretrained weights first
TRAINABLE = sorted(name for name, config in PRESETS.items() if not config.freeze_vits)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m gapmes.model.training", description=__doc__)
    parser.add_argument("out", type=Path, help="folder of the run; an interrupted run continues from it")
    parser.add_argument("--preset", choices=TRAINABLE, default="tiny")
    parser.add_argument("--steps", type=int, default=Recipe.steps)
    parser.add_argument("--seed", type=int, default=Recipe.seed)
    parser.add_argument("--threads", type=int, default=1, help="one thread per process is fastest on shared cores")
    parser.add_argument("--validate-every", type=int, default=250, metavar="STEPS")
    for switch in ("without-depth", "without-experts", "without-tasks"):
        parser.add_argument(f"--{switch}", action="store_true", help="ablation")
    options = parser.parse_args(arguments)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s", stream=sys.stderr)
    torch.set_num_threads(options.threads)
    numba.set_num_threads(options.threads)
    config = preset(
        options.preset,
        without_depth=options.without_depth,
        without_experts=options.without_experts,
        without_tasks=options.without_tasks,
    )
    recipe = replace(Recipe(), steps=options.steps, seed=options.seed)
    train(config, recipe, options.out, validate_every=options.validate_every)
    logging.getLogger(__name__).info("weights: %s", options.out / WEIGHTS)
    return 0


if __name__ == "__main__":
    sys.exit(main())
