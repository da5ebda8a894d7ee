"""Profile a network in onnxruntime, by module and by operator, relative to the machine's own peak.

`python -m benchmarks.network.profile MODEL.onnx …` runs each float32 network with the service's settings on one thread.
In turns with it runs the matrix product that onnxruntime does best. Figures are medians of wall times over the rounds.
GFLOP are what onnxruntime computes. That is more than the network's own operations, since it writes means over windows
as products and pads channels to whole blocks. The exporter names a node after its module. A node that onnxruntime
itself inserts counts towards the module whose result it reads.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import onnx
import onnxruntime

from gapmes.export.samples import random_scene
from gapmes.service.network.backends.onnxruntime_session import session_options
from gapmes.service.network.contract import INPUTS
from gapmes.service.network.model_file import model_file

from ..options import at_least_one, refusals_told, there, view_count
from .worker import matrix_product

KERNEL = "_kernel_time"
PRODUCTS = ("MatMul", "FusedMatMul", "Gemm", "FusedGemm")
LAID_OUT = "_nchwc"  # suffix of results that onnxruntime computes in blocks of channels
SHOWN = 0.01  # of the whole time: smaller groups are added up


@dataclass(frozen=True)
class Kernel:
    """One node of one run."""

    name: str
    operator: str
    seconds: float
    operations: float


def operations(operator: str, given: list[list[int]], made: list[list[int]]) -> float:
    """Multiply-adds of a node, counted as two; 0 for all but products and convolutions."""
    if operator in PRODUCTS:
        inner = given[0][-1] * given[0][-2] // made[0][-2]  # also if the first factor is read transposed
        return 2.0 * math.prod(made[0]) * inner
    if operator in ("Conv", "FusedConv"):
        return 2.0 * math.prod(made[0]) * math.prod(given[1][1:])
    if operator == "ConvTranspose":
        return 2.0 * math.prod(given[0]) * math.prod(given[1][1:])
    return 0.0


def kernels(events: Iterable[dict[str, Any]]) -> list[list[Kernel]]:
    """The kernels of every run in onnxruntime's profile."""
    runs: list[list[Kernel]] = [[]]
    for event in events:
        if event.get("name") == "model_run":
            runs.append([])
        elif event.get("cat") == "Node" and event["name"].endswith(KERNEL):
            args = event["args"]
            given, made = (
                [shape for one in args[key] for shape in one.values()]
                for key in ("input_type_shape", "output_type_shape")
            )
            operator = args["op_name"]
            name = event["name"].removesuffix(KERNEL)
            runs[-1].append(Kernel(name, operator, event["dur"] / 1e6, operations(operator, given, made)))
    return [run for run in runs if run]


def modules(exported: onnx.ModelProto, optimised: onnx.ModelProto, depth: int) -> Callable[[str], str]:
    """Finds the module of a node by its name: the first `depth` parts of its path below the network."""
    makers = {output: node.name for node in exported.graph.node for output in node.output if output}
    known = {node.name for node in exported.graph.node}
    sources = {output: node for node in optimised.graph.node for output in node.output if output}
    nodes = {node.name: node for node in optimised.graph.node if node.name}

    def path(name: str) -> str:
        name = makers.get(name.removesuffix(LAID_OUT), name)
        if name.startswith("network.") or name in known:
            return name.split("/")[0]
        node = nodes.get(name)
        source = sources.get(node.input[0]) if node is not None and node.input else None
        return path(source.name) if source is not None else ""

    return lambda name: ".".join(path(name).split(".")[1 : 1 + depth]) or "(of none)"


def profiled(
    model: Path, views: int, rounds: int, depth: int
) -> tuple[list[list[Kernel]], Callable[[str], str], float]:
    """The kernels of `rounds` runs, the finder of their modules, and the peak in operations per second."""
    info = model_file(model).info
    if info.precision != "fp32":
        raise ValueError(f"{model}: precision is {info.precision}, need fp32: products of integers are not counted")
    scene = random_scene(views, info.height, info.width, seed=views)
    feed = {name: value.numpy() for name, value in zip(INPUTS, scene.tensors(), strict=True)}
    product, product_operations = matrix_product()
    with tempfile.TemporaryDirectory() as folder:
        options = session_options(threads=1)
        options.enable_profiling = True
        options.profile_file_prefix = str(Path(folder) / "profile")
        options.optimized_model_filepath = str(Path(folder) / "optimised.onnx")
        session = onnxruntime.InferenceSession(str(model), options, providers=["CPUExecutionProvider"])
        seconds = []
        for number in range(rounds + 1):
            start = time.perf_counter()
            product()
            seconds.append(time.perf_counter() - start)
            session.run(None, feed)
            sys.stderr.write(f"{model.stem}: run {number} of {rounds}\n")
        runs = kernels(json.loads(Path(session.end_profiling()).read_text()))[1:]
        optimised = onnx.load(options.optimized_model_filepath, load_external_data=False)
    exported = onnx.load(model, load_external_data=False)
    return runs, modules(exported, optimised, depth), product_operations / statistics.median(seconds[1:])


def table(runs: list[list[Kernel]], groups: dict[str, str], peak: float) -> list[str]:
    """Markdown rows of groups of nodes, the largest first: milliseconds, share of the whole, GFLOP, share of peak."""
    spent: dict[str, list[float]] = defaultdict(lambda: [0.0] * len(runs))
    flop: dict[str, float] = defaultdict(float)
    for number, run in enumerate(runs):
        for kernel in run:
            spent[groups[kernel.name]][number] += kernel.seconds
    for kernel in runs[0]:
        flop[groups[kernel.name]] += kernel.operations
    medians = {name: statistics.median(seconds) for name, seconds in spent.items()}
    whole = statistics.median(sum(kernel.seconds for kernel in run) for run in runs)
    shown = sorted((name for name in medians if medians[name] >= SHOWN * whole), key=lambda name: -medians[name])
    lines = [
        f"| {name} | {1e3 * medians[name]:.0f} | {medians[name] / whole:.0%} | {flop[name] / 1e9:.1f} "
        f"| {flop[name] / medians[name] / peak:.0%} |"
        for name in shown
    ]
    rest = sum(medians[name] for name in medians if name not in shown)
    total = sum(flop.values())
    return [
        *lines,
        f"| others | {1e3 * rest:.0f} | {rest / whole:.0%} | | |",
        f"| all | {1e3 * whole:.0f} | | {total / 1e9:.1f} | {total / whole / peak:.0%} |",
    ]


@refusals_told()
def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.network.profile", description=__doc__.splitlines()[0])
    parser.add_argument("models", nargs="+", type=there, metavar="MODEL.onnx")
    parser.add_argument("--views", type=view_count, default=2)
    parser.add_argument("--rounds", type=at_least_one, default=5)
    parser.add_argument("--depth", type=at_least_one, default=2, help="parts of a module's path that are distinguished")
    options = parser.parse_args()
    for model in options.models:
        runs, module, peak = profiled(model, options.views, options.rounds, options.depth)
        sys.stdout.write(f"### {model.stem}, {options.views} views, peak {peak / 1e9:.0f} GFLOP/s\n")
        for title, names in (
            ("module", {kernel.name: module(kernel.name) for kernel in runs[0]}),
            ("operator", {kernel.name: kernel.operator for kernel in runs[0]}),
        ):
            sys.stdout.write(f"\n| {title} | ms | of all | GFLOP | of peak |\n|---|---|---|---|---|\n")
            sys.stdout.write("\n".join(table(runs, names, peak)) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
