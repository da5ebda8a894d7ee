"""`python -m gapmes.model.training.ablation OUT`: the paper's ablations at tiny scale with equal budgets, resumable."""

from __future__ import annotations

import argparse
import json
import re
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from threading import Event, Thread

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from gapmes.service.process.disk import replace_file

from . import arguments as kinds
from .ablation_runs import VARIANTS, WIDE, Budget, Run, by_scene, run_in
from .ablation_table import Scores, check_comparable, tables
from .lpips import Lpips
from .step import TensorBatch
from .study import asked_lpips, carry_out, parse

RESULT, TABLES = "ablation.json", "ablation.md"
MARKER = "tables"  # of the page
POLL_SECONDS = 1.0
Results = dict[str, dict[int, Scores]]


class StudyProgress:
    """Which run of how many, its step and the time left; a bar on a terminal, lines elsewhere."""

    def __init__(self, console: Console, runs: Sequence[Run]) -> None:
        self._console, self._runs = console, runs
        self._left = sum(run.budget.steps - run.step() for run in runs)
        self._begun = time.monotonic()
        self._done = 0
        columns = TextColumn("{task.description}"), BarColumn(bar_width=30), TextColumn("{task.fields[left]}")
        self._progress = Progress(*columns, console=console, disable=not console.is_terminal, transient=True)
        self._task = self._progress.add_task("", total=self._left, left="")

    @contextmanager
    def watch(self, run: Run) -> Iterator[None]:
        """Follow the log of a run while the block lasts, from a thread of its own."""
        stop = Event()
        thread = Thread(target=self._follow, args=(run, self._done, run.step(), stop), daemon=True)
        self._progress.start()
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()
            self._progress.stop()

    def _follow(self, run: Run, before: int, start: int, stop: Event) -> None:
        seen = -1
        while True:
            ended = stop.wait(POLL_SECONDS if seen >= 0 else 0.0)
            step = run.step()
            if step > seen:
                self._done = before + step - start
                self._show(run, step)
                seen = step
            if ended:
                return

    def _show(self, run: Run, step: int) -> None:
        number = self._runs.index(run) + 1
        text = f"run {number} of {len(self._runs)}  {run.name} (seed {run.seed})  step {step}/{run.budget.steps}"
        left = "time left: not known yet"
        if self._done > 0:
            seconds = (time.monotonic() - self._begun) / self._done * (self._left - self._done)
            left = f"about {seconds / 60:.1f} min left"
        self._progress.update(self._task, description=text, completed=self._done, left=left)
        if not self._console.is_terminal:
            self._console.print(f"{text}  {left}", markup=False)


def ablate(
    out: Path,
    names: Sequence[str],
    seeds: Sequence[int],
    budget: Budget,
    console: Console,
    lpips: Lpips | None = None,
) -> Results:
    """Run what is not finished, all variants of a seed before the next seed; results are written after every run.

    With `lpips`, what was scored without it, or with other weights, is scored again and not trained again. The results
    hold every finished run below `out`, also those that were not asked for now. Raises `ValueError` when `out`
    holds runs of another budget, of a generator that drew other validation scenes, with LPIPS of other weights that
    were not asked for now, or without the weights that LPIPS is to be added from.
    """
    runs = [run_in(out, name, seed, budget) for seed in dict.fromkeys(seeds) for name in dict.fromkeys(names)]
    results = finished(out, budget)
    open_runs = [run for run in runs if run.seed not in results[run.name]]
    console.print(f"{len(runs)} runs, {len(runs) - len(open_runs)} of them finished before", markup=False)
    batches = budget.batches()
    if lpips is not None:
        _add_lpips(results, runs, batches, lpips, console)
    check_comparable(results)
    progress = StudyProgress(console, open_runs)
    for run in open_runs:
        with progress.watch(run):
            results[run.name][run.seed] = scores = run.execute(batches, lpips)
        check_comparable(results)
        console.print(
            f"{run.name} (seed {run.seed}): {scores.psnr.mean():.2f} dB, SSIM {scores.ssim.mean():.4f}, "
            f"depth error {scores.depth_error.mean():.4f}, {scores.minutes:.1f} min",
            markup=False,
        )
        write_results(out, results, budget)
    write_results(out, results, budget)
    return results


def _add_lpips(
    results: Results, runs: Sequence[Run], batches: Sequence[TensorBatch], lpips: Lpips, console: Console
) -> None:
    """To those of `runs` that are finished; nothing is written when the others have it from other weights."""
    lacking = {
        (run.name, run.seed): run
        for run in runs
        if run.seed in results[run.name] and results[run.name][run.seed].lpips_weights != lpips.fingerprint
    }
    planned = {name: dict(by_seed) for name, by_seed in results.items()}
    for name, seed in lacking:
        planned[name][seed] = replace(results[name][seed], lpips_weights=lpips.fingerprint)
    check_comparable(planned)
    for number, ((name, seed), run) in enumerate(lacking.items(), 1):
        results[name][seed] = run.add_lpips(results[name][seed], batches, lpips)
        console.print(f"LPIPS {number} of {len(lacking)}  {name} (seed {seed}) was finished before", markup=False)


def finished(out: Path, budget: Budget) -> Results:
    """Scores of all finished runs below `out`, by variant and seed; raises `ValueError` for one of another budget."""
    results: Results = {name: {} for name in VARIANTS}
    for name in VARIANTS:
        for seed in _seeds(out, name):
            scores = run_in(out, name, seed, budget).scores()
            if scores is not None:
                results[name][seed] = scores
    return results


def _seeds(out: Path, name: str) -> list[int]:
    """Of the runs of a variant below `out`, whose folders are named as `run_in` names them; others are not ours."""
    names = [folder.name for folder in out.iterdir()] if out.is_dir() else []
    found = (re.fullmatch(re.escape(name) + r"-seed(0|[1-9]\d*)", folder, re.ASCII) for folder in names)
    return sorted(int(match[1]) for match in found if match)


def write_results(out: Path, results: Results, budget: Budget) -> None:
    """ablation.json with every number of every scene, ablation.md with the tables."""
    variants = {
        name: {
            "changes": VARIANTS[name],
            "runs": [
                {"seed": seed, "parameters": scores.parameters, "minutes": scores.minutes, **by_scene(scores)}
                for seed, scores in sorted(runs.items())
            ],
        }
        for name, runs in results.items()
        if runs
    }
    body = {"budget": asdict(budget), "baseline": WIDE, "variants": variants}
    replace_file(out / RESULT, (json.dumps(body, indent=1, allow_nan=False) + "\n").encode())
    replace_file(out / TABLES, tables(results, caption(results, budget)).encode())


def caption(results: Results, budget: Budget) -> str:
    """What the tables rest on, in one paragraph; at least one run must be finished."""
    seeds = sorted({seed for runs in results.values() for seed in runs})
    copies = [float(np.mean(scores.copy_psnr)) for runs in results.values() for scores in runs.values()]
    copied = f" The nearer input shown as it is has {copies[0]:.2f} dB there."
    return (
        f"Every run: {budget.steps} steps of {budget.training_scenes} scenes at {budget.size} px, training "
        f"seed{'s' * (len(seeds) > 1)} {', '.join(map(str, seeds))}; scored on {budget.validation_scenes} scenes with "
        f"a baseline of {WIDE[0]} to {WIDE[1]} of their depth.{copied}"
    )


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m gapmes.model.training.ablation", description=__doc__)
    parser.add_argument("out", type=kinds.folder, help="folder of the runs; an interrupted study continues from it")
    parser.add_argument("--steps", type=int, default=Budget.steps, help="of every variant")
    parser.add_argument("--seeds", type=kinds.seed(), nargs="+", default=[1], metavar="SEED", help="training seeds")
    parser.add_argument("--only", nargs="+", choices=VARIANTS, default=list(VARIANTS), metavar="NAME", help="variants")
    options = parse(parser, arguments)
    console = Console(stderr=True, highlight=False, soft_wrap=True)

    def study() -> str:
        budget = Budget(steps=options.steps)
        ablate(options.out, options.only, options.seeds, budget, console, asked_lpips(options))
        return (options.out / TABLES).read_text(encoding="utf-8")

    def show(text: str) -> None:
        console.print(f"\n{text}\nwritten: {options.out / RESULT}, {options.out / TABLES}", markup=False)

    stopped = "the same command goes on from here"
    return carry_out(study, show, page=options.page, marker=MARKER, console=console, stopped=stopped)


if __name__ == "__main__":
    sys.exit(main())
