"""`python -m gapmes.model.training.choice OUT.npz`: trains the small network that chooses among candidates for depths.

The loss of a pixel is the mean of a robust cost, |error| / (|error| + 1.5 px), over its candidates, weighted by the
softmax of their scores. Large errors count little more than moderate ones, as they do in a rendered picture.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor, nn

from gapmes.service import Reconstructor
from gapmes.service.errors import InputError
from gapmes.service.mending.choice.candidates import ABOUT, COUNT, KNOWN
from gapmes.service.mending.choice.network import ChoiceNetwork
from gapmes.service.process.disk import named
from gapmes.service.process.output_file import check_output_file
from gapmes.service.process.terminal import QUIET_HELP, ProgressBars
from gapmes.service.process.with_parent import end_with_parent
from gapmes.service.progress import Stages

from .arguments import seed as any_seed
from .arguments import whole_number
from .choice_data import Samples, joined, scene_samples
from .interrupts import without_interrupts
from .run_folder import Refused
from .workers import limit_threads

HIDDEN = 32
SCENES = 400
STEPS, BATCH, RATE, WARM_UP, DECAY = 4_000, 2_048, 3e-3, 100, 1e-4
SCALE = 1.5  # px: error with a cost of 1/2
HELD_OUT = 8  # every eighth scene is held out for evaluation


class Choice(nn.Module):
    """`service/mending/choice/kernels.py` in torch."""

    def __init__(self) -> None:
        super().__init__()
        self.known = nn.Linear(KNOWN, HIDDEN, bias=False)
        self.about = nn.Linear(ABOUT, HIDDEN, bias=False)
        self.place = nn.Parameter(torch.zeros(COUNT, HIDDEN))
        self.own = nn.Linear(HIDDEN, HIDDEN)
        self.shared = nn.Linear(HIDDEN, HIDDEN, bias=False)
        self.out = nn.Linear(HIDDEN, 1, bias=False)
        self.prior = nn.Parameter(torch.zeros(COUNT))

    def forward(self, known: Tensor, about: Tensor) -> Tensor:
        """(N, K) scores of known (N, K, F) and about (N, G)."""
        first = F.relu(self.known(known) + self.about(about)[:, None] + self.place)
        second = F.relu(self.own(first) + self.shared(first.mean(1))[:, None])
        return self.out(second)[..., 0] + self.prior

    def exported(self) -> ChoiceNetwork:
        """The same for the service."""
        values = (
            self.known.weight.T, self.about.weight.T, self.place, self.own.weight.T, self.shared.weight.T,
            self.own.bias, self.out.weight[0], self.prior,
        )  # fmt: skip
        return ChoiceNetwork(*(value.detach().numpy().astype(np.float32) for value in values))


def cost(error: Tensor) -> Tensor:
    """Robust cost, 0 to 1, of errors in px."""
    return error.abs() / (error.abs() + SCALE)


def held_out(samples: Samples) -> NDArray[np.bool_]:
    """(N,) which pixels belong to held-out scenes."""
    return samples.scene % HELD_OUT == HELD_OUT - 1


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let torch use one thread: another number would sum in another order, and round differently."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@_one_thread()
def trained(samples: Samples, seed: int, steps: int, done: Callable[[int], None] = lambda _: None) -> Choice:
    """Train from random weights of `seed` on all but the held-out scenes; `done` is called with the number of finished
    steps. Raises `Refused` for a loss that is not finite."""
    torch.manual_seed(seed)
    network = Choice()
    rows = np.flatnonzero(~held_out(samples))
    known = torch.from_numpy(np.ascontiguousarray(samples.known.transpose(2, 0, 1)))
    about = torch.from_numpy(np.ascontiguousarray(samples.about.T))
    costs = cost(torch.from_numpy(np.ascontiguousarray(samples.error.T)))
    optimiser = torch.optim.AdamW(network.parameters(), lr=RATE, weight_decay=DECAY)
    rng = np.random.default_rng(seed)
    for step in range(steps):
        for group in optimiser.param_groups:
            group["lr"] = RATE * min(1.0, (step + 1) / WARM_UP) * (1 - step / steps)
        taken = rows[rng.integers(len(rows), size=BATCH)]
        shares = network(known[taken].float(), about[taken].float()).softmax(1)
        loss = (shares * costs[taken]).sum(1).mean()
        if not torch.isfinite(loss):
            raise Refused(f"step {step + 1}: the loss is {loss.item()}, need a finite one: take another --seed")
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        done(step + 1)
    return network


def figures(network: ChoiceNetwork, samples: Samples) -> dict[str, tuple[float, float]]:
    """Mean cost and share of errors below 1 px on the held-out scenes: of the current depth, of the preferred candidate
    and of the best one."""
    held = held_out(samples)
    error = np.abs(samples.error[:, held])
    best = network.preferences(samples.known[..., held], samples.about[:, held]).argmax(axis=0)
    preferred = error[best, np.arange(len(best))]
    rows = {"as it is": error[0], "preferred": preferred, "best": error.min(axis=0)}
    return {name: (float(cost(torch.from_numpy(row)).mean()), float((row < 1).mean())) for name, row in rows.items()}


_state: dict[str, Reconstructor] = {}


def _begin(parent: int) -> None:
    """Initialise a process: one thread, and a network of its own."""
    end_with_parent(parent)
    limit_threads(1)
    _state["reconstructor"] = Reconstructor(None, threads=1)


def _sampled(seed: int, number: int) -> Samples | None:
    return scene_samples(_state["reconstructor"], seed, number)


def _generated(seed: int, scenes: int, processes: int) -> Iterator[Samples | None]:
    """The scenes' samples in their order, whatever the number of processes."""
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=spawn, initializer=_begin, initargs=(os.getpid(),)) as pool:
        with without_interrupts():  # this process tells of one, and ends the others
            samples = pool.map(_sampled, [seed] * scenes, range(scenes))
        try:
            yield from samples
        except BaseException:
            pool.shutdown(cancel_futures=True)  # else all remaining scenes would be generated first
            raise


def _collected(options: argparse.Namespace, stages: Stages) -> tuple[Samples, int]:
    """All samples and the number of scenes that have any; raises `Refused` if training or evaluation has none."""
    with stages.stage("scenes", options.scenes) as done:
        parts = []
        for number, part in enumerate(_generated(options.seed, options.scenes, options.processes), start=1):
            parts += [] if part is None else [part]
            done(number)
    held = [held_out(part) for part in parts]
    lacking = {"training": all(each.all() for each in held), "the figures": not any(each.any() for each in held)}
    if which := next((name for name, lacks in lacking.items() if lacks), None):
        raise Refused(f"{len(parts)} of {options.scenes} scenes have a choice, none of those for {which}: take more")
    return joined(parts), len(parts)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m gapmes.model.training.choice", description=__doc__)
    parser.add_argument("out", type=Path, help=".npz to write; replaced only when all is well")
    parser.add_argument("--scenes", type=whole_number(HELD_OUT), default=SCENES, help="default %(default)s")
    parser.add_argument("--steps", type=whole_number(1), default=STEPS, help="default %(default)s")
    parser.add_argument("--seed", type=any_seed(), default=1, help="of scenes and weights, default %(default)s")
    parser.add_argument("--processes", type=whole_number(1), default=1, help="that make scenes; the result is the same")
    parser.add_argument("--quiet", "-q", action="store_true", help=QUIET_HELP)
    options = parser.parse_args(arguments)
    try:
        check_output_file(options.out, field="out")
        with ProgressBars(quiet=options.quiet) as bars:
            stages = Stages(bars)
            samples, scenes = _collected(options, stages)
            with stages.stage("train", options.steps) as done:
                network = trained(samples, options.seed, options.steps, done).exported()
        with named(options.out):
            network.save(options.out)
    except (Refused, InputError, OSError) as error:
        sys.stderr.write(f"refused: {error}\n")
        return 1
    except BrokenProcessPool:
        sys.stderr.write("refused: a process that makes scenes ended, by lack of memory or by the error above\n")
        return 1
    except KeyboardInterrupt:
        sys.stderr.write("stopped; nothing is kept\n")
        return 130
    count = len(samples.scene)
    sys.stdout.write(f"{options.out}: {count} pixels of {scenes} scenes, every {HELD_OUT}th for these figures\n")
    for name, (mean, near) in figures(network, samples).items():
        sys.stdout.write(f"{name:10s} cost {mean:.4f}, within 1 px {near:.1%}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
