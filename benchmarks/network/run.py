"""Time every network in every runtime, in turns on one thread: medians of CPU seconds, ratios, share of the peak.

`python -m benchmarks.network.run MODEL.onnx=CHECKPOINT[=INT8.onnx] …`; without its checkpoint a model does not run in
torch, and an int8 file runs in onnxruntime only. Ratios are to onnxruntime, which always runs. Only the processes of
one model and one number of views exist at a time.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from gapmes.service.process.terminal import ProgressBars

from ..options import at_least_one, model_files, refusals_told, view_count
from .intel import told_intel
from .worker import RUNTIMES

BASE = "onnxruntime"  # what times are compared with


@dataclass
class Timed:
    """One process, its answers, and the file of its error messages."""

    name: str
    process: subprocess.Popen[str]
    errors: IO[str]
    rows: list[dict[str, float]] = field(default_factory=list)

    def run(self) -> None:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        with suppress(BrokenPipeError):  # it has ended already: the empty answer below shows it
            self.process.stdin.write("\n")
            self.process.stdin.flush()
        line = self.process.stdout.readline()
        if not line:
            code = self.process.wait()
            self.errors.seek(0)
            raise SystemExit(f"error: {self.name} ended with {code}: {self.errors.read().strip()[-1500:]}")
        self.rows.append(json.loads(line))

    def median(self, what: str = "cpu") -> float:
        return statistics.median(row[what] for row in self.rows)


@contextmanager
def worker(
    name: str, runtime: str, model: Path, checkpoint: Path, views: int, extra: dict[str, str]
) -> Iterator[Timed]:
    command = [sys.executable, "-m", "benchmarks.network.worker", runtime, str(model)]
    command += ["--checkpoint", str(checkpoint), "--views", str(views)]
    environment = os.environ | extra | {"OMP_NUM_THREADS": "1"}
    with (
        tempfile.TemporaryFile("w+") as errors,
        subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True, env=environment
        ) as process,
    ):
        try:
            yield Timed(name, process, errors)
        except BaseException:  # also for another process's error: this one may be compiling for minutes
            process.kill()
            raise
        finally:
            assert process.stdin is not None
            with suppress(BrokenPipeError):
                process.stdin.close()
            process.wait()


def compare(
    model: Path,
    checkpoint: Path | None,
    int8: Path | None,
    views: int,
    rounds: int,
    intel: dict[str, str],
    runtimes: Sequence[str],
) -> list[Timed]:
    """All runtimes of one network, one run of each per round; the first round is not counted."""
    plan: list[tuple[str, str, Path, dict[str, str]]] = [("matrix product", "peak", model, {})]
    chosen = [runtime for runtime in RUNTIMES if runtime in (BASE, *runtimes)]
    plan += [(runtime, runtime, model, {}) for runtime in chosen if checkpoint or "torch" not in runtime]
    if int8 is not None:
        plan.append(("onnxruntime int8", "onnxruntime", int8, {}))
    if checkpoint and intel:
        plan.append(("torch, MKL told Intel", "torch", model, intel))
    with ExitStack() as stack, ProgressBars() as bars:
        timed = [
            stack.enter_context(worker(name, runtime, file, checkpoint or model, views, extra))
            for name, runtime, file, extra in plan
        ]
        for one in timed:
            one.run()
            one.rows.clear()
        for number in range(rounds):
            for one in timed:
                one.run()
            bars.say(f"{model.stem}, {views} views: round {number + 1} of {rounds}")
    return timed


def table(timed: Sequence[Timed]) -> list[str]:
    """Markdown rows: seconds, ratio to onnxruntime, share of peak."""
    by = {one.name: one for one in timed}
    peak = by["matrix product"].rows[0]["operations"] / by["matrix product"].median()
    flop = max((one.rows[0]["operations"] for one in timed if one.name == "torch"), default=0.0)
    base = by[BASE].median()
    lines = []
    for one in timed:
        if one.name == "matrix product":
            continue
        share = f"{flop / one.median() / peak:.0%}" if flop else "-"
        lines.append(
            f"| {one.name} | {one.median():.3f} | {one.median() / base:.2f} | {share} | {one.median('peak_mb'):.0f} |"
        )
    counted = f"; the network has {flop / 1e9:.1f} GFLOP" if flop else ""
    lines.append(f"\nmatrix product {peak / 1e9:.0f} GFLOP/s on one core{counted}\n")
    return lines


@refusals_told()
def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.network.run", description=__doc__.splitlines()[0])
    kind = model_files(least=1, most=3)
    parser.add_argument("models", nargs="+", type=kind, metavar="MODEL.onnx[=CHECKPOINT[=INT8.onnx]]")
    parser.add_argument("--views", type=view_count, nargs="+", default=[2, 4])
    parser.add_argument("--runtimes", nargs="+", choices=RUNTIMES, default=RUNTIMES)
    parser.add_argument("--rounds", type=at_least_one, default=5)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        intel = told_intel(Path(folder))
        for files in options.models:
            model, checkpoint, int8 = (*files, None, None)[:3]
            for views in options.views:
                sys.stdout.write(
                    f"### {model.stem}, {views} views\n\n| runtime | CPU s | ratio | of peak | peak MB |\n"
                )
                sys.stdout.write("|---|---|---|---|---|\n")
                lines = table(compare(model, checkpoint, int8, views, options.rounds, intel, options.runtimes))
                sys.stdout.write("\n".join(lines) + "\n")
                sys.stdout.flush()


if __name__ == "__main__":
    main()
