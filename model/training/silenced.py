"""`python -m gapmes.model.training.silenced`: what a trained network loses when one part of it falls silent.

Nothing is trained. The ablation study scores networks that were trained without the part; this measures how much a
trained network depends on it. It cannot tell what the other parts would have learnt in its place.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import cast

import torch
from rich.console import Console
from torch import Tensor, nn

from ..checkpoint import load_checkpoint, shipped_checkpoint
from ..experts import chosen_experts
from ..network import GaPMeS
from ..routing import Routing
from . import arguments as kinds
from .ablation_runs import WIDE, scene_scores
from .ablation_table import SHOWN, Scores, cell, head, paired, row
from .lpips import Lpips
from .study import asked_lpips, carry_out, parse
from .validation import validation_batches

LARGEST = 512  # px; time and memory grow with the square, and nothing is trained at more than 256
WHOLE, MARKER = "nothing", "silenced"
ALL_STREAMS = "all streams"
SHUFFLE_SEED = 0
Reroute = Callable[[Routing], Routing]


def _no_experts(routing: Routing) -> Routing:
    return replace(routing, expert_weight=chosen_experts(routing)[1] * 0)


def _shuffled(routing: Routing) -> Routing:
    """Permute the routes at random over the patches: each expert keeps its load, the choice loses its meaning."""
    index, weight = chosen_experts(routing)
    other = torch.randperm(len(index), generator=torch.Generator().manual_seed(SHUFFLE_SEED)).to(index.device)
    return replace(routing, expert_index=index[other], expert_weight=weight[other])


def _no_tasks(routing: Routing) -> Routing:
    return replace(routing, task_weight=_task_weight(routing) * 0)


def _even_tasks(routing: Routing) -> Routing:
    """Give every patch the mean weights: each task keeps its mean weight, the choice is lost."""
    weight = _task_weight(routing)
    return replace(routing, task_weight=weight.mean(0, keepdim=True).expand_as(weight))


def _task_weight(routing: Routing) -> Tensor:
    """The task weights, which are never None here: `parts` lists no task part for a network without tasks."""
    return cast(Tensor, routing.task_weight)


# part, as the table names it: what is done to the routing of the gates
GATES: dict[str, Reroute] = {
    "experts": _no_experts,
    "choice of experts": _shuffled,
    "task weights": _no_tasks,
    "choice of task weights": _even_tasks,
}


def _flat(_align: nn.Module, inputs: tuple[Tensor]) -> tuple[Tensor]:
    """Replace features (n, C, h, w) of a stream by their mean over each image."""
    return (inputs[0].mean((-2, -1), keepdim=True).expand_as(inputs[0]),)


def parts(model: GaPMeS) -> list[str]:
    """Names of what can be silenced in this network: its streams, then what belongs to its gates."""
    config = model.config
    lacking = [name for name in GATES if "experts" in name and config.without_experts]
    lacking += [name for name in GATES if "task" in name and config.without_tasks]
    streams = [f"{stream} stream" for stream in config.streams]
    return [*streams, ALL_STREAMS, *(name for name in GATES if name not in lacking)]


@contextmanager
def silenced(model: GaPMeS, part: str) -> Iterator[None]:
    """The network without what one of `parts` adds while the block lasts; raises `KeyError` for another name.

    A silenced stream tells the mixture nothing but its means over each image, the same everywhere; depth is estimated
    as ever.
    """
    if part not in parts(model):
        raise KeyError(f"{part!r} is no part of this network, which has {', '.join(parts(model))}")
    if part in GATES:
        reroute = GATES[part]
        gates = model.mixture.get_submodule("gates")
        handles = [gates.register_forward_hook(lambda _module, _inputs, routing: reroute(routing))]
    else:
        handles = [
            align.register_forward_pre_hook(_flat)
            for name, align in model.mixture.align.items()
            if part in (f"{name} stream", ALL_STREAMS)
        ]
    try:
        yield
    finally:
        for handle in handles:
            handle.remove()


def measure(model: GaPMeS, size: int, scenes: int, lpips: Lpips | None, console: Console) -> dict[str, Scores]:
    """Figures of the network as it is, under `WHOLE`, and with each part silenced, on the same scenes."""
    batches = validation_batches(size, scenes, WIDE)
    found: dict[str, Scores] = {}
    names = [WHOLE, *parts(model)]
    for number, name in enumerate(names, 1):
        if name == WHOLE:
            found[name] = scene_scores(model, batches, 0.0, lpips)
        else:
            with silenced(model, name):
                found[name] = scene_scores(model, batches, 0.0, lpips)
        console.print(f"{number} of {len(names)}  {name} silenced: {found[name].psnr.mean():.2f} dB", markup=False)
    return found


def table(found: dict[str, Scores], caption: str) -> str:
    """Markdown: the figures of the whole network, then the differences to them with their errors over scenes."""
    shown = [figure for figure in SHOWN if getattr(found[WHOLE], figure[0]) is not None]
    lines = [caption, "", *head(["silenced", *(title for _, title, _ in shown)])]
    lines.append(row([WHOLE, *(f"{getattr(found[WHOLE], field).mean():.{digits}f}" for field, _, digits in shown)]))
    for name, scores in found.items():
        if name != WHOLE:
            differences = [
                cell(paired(getattr(scores, field)[None], getattr(found[WHOLE], field)[None]), digits)
                for field, _, digits in shown
            ]
            lines.append(row([name, *differences]))
    return "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m gapmes.model.training.silenced", description=__doc__)
    parser.add_argument("--weights", type=Path, metavar="FILE", help="checkpoint; default: the shipped tiny one")
    parser.add_argument("--scenes", type=kinds.whole_number(1), default=64)
    parser.add_argument("--size", type=kinds.whole_number(32, LARGEST), default=128, help="px")
    options = parse(parser, arguments)
    console = Console(stderr=True, highlight=False, soft_wrap=True)

    def study() -> str:
        path = options.weights or shipped_checkpoint("tiny")
        model = load_checkpoint(path)
        if options.size % (step := model.config.size_step):
            raise ValueError(f"--size is {options.size}, need a multiple of {step} for these weights")
        found = measure(model, options.size, options.scenes, asked_lpips(options), console)
        scenes, their = ("1 scene", "its") if options.scenes == 1 else (f"{options.scenes} scenes", "their")
        caption = (
            f"`{path.name}` on {scenes} at {options.size} px with a baseline of {WIDE[0]} to {WIDE[1]} "
            f"of {their} depth; the nearer input shown as it is has {found[WHOLE].copy_psnr.mean():.2f} dB there."
        )
        return table(found, caption)

    stopped = "nothing is kept"
    return carry_out(study, sys.stdout.write, page=options.page, marker=MARKER, console=console, stopped=stopped)


if __name__ == "__main__":
    sys.exit(main())
