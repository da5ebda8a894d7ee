"""Measure what routing saves: experts on routed patches against all experts on all patches, even and skewed routing.

`python -m benchmarks.network.experts` runs the expert group of each preset in onnxruntime on one thread, all settings
in turns. A run without any cost beyond its arithmetic would take k / N_e of the dense one.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
import warnings

import numpy as np
import onnx
import onnx_ir as ir
import onnxruntime as ort
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.export import Dim

from gapmes.export.fold import folded
from gapmes.model.config import CELLS_PER_PATCH, ModelConfig, preset
from gapmes.model.experts import ExpertGroup
from gapmes.model.routing import Routing

from ..options import at_least_one

PRESETS = ("tiny", "small", "base")
PATCHES = 2 * 16 * 16  # two views of 256 x 256 px


class Routed(nn.Module):
    """The expert group, which takes its routing as tensors."""

    def __init__(self, config: ModelConfig, *, sparse: bool) -> None:
        super().__init__()
        self.group = ExpertGroup(config.experts, config.stream_channels)
        self.group.sparse = sparse

    def forward(self, patches: Tensor, index: Tensor, weight: Tensor) -> Tensor:
        return self.group(patches, Routing(index, weight, None, None, patches.new_zeros(())))


def session(config: ModelConfig, *, sparse: bool) -> ort.InferenceSession:
    torch.manual_seed(0)
    module = Routed(config, sparse=sparse).eval()
    patches = torch.zeros(40, len(config.streams) * config.stream_channels, CELLS_PER_PATCH, CELLS_PER_PATCH)
    index = torch.stack([torch.zeros(40), torch.ones(40)], dim=1).long()
    count = Dim("M", min=2, max=6 * 256)
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            module,
            (patches, index, torch.full((40, config.top_k), 0.5)),
            dynamo=True,
            input_names=["patches", "index", "weight"],
            dynamic_shapes={"patches": {0: count}, "index": {0: count}, "weight": {0: count}},
            opset_version=20,
            verbose=False,
            optimize=False,
        )
    assert program is not None
    model = ir.to_proto(folded(program.model))
    onnx.checker.check_model(model)
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    options.log_severity_level = 3
    return ort.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])


def routes(config: ModelConfig, random: np.random.Generator) -> dict[str, NDArray[np.int64]]:
    """Experts of every patch (M, k), by name of the skew."""

    def drawn(shares: NDArray[np.float64]) -> NDArray[np.int64]:
        rows = [random.choice(config.experts, config.top_k, replace=False, p=shares) for _ in range(PATCHES)]
        return np.array(rows, np.int64)

    falling = 1 / np.arange(1, config.experts + 1) ** 2
    return {
        "even": drawn(np.full(config.experts, 1 / config.experts)),
        "falling as 1, 1/4, 1/9, …": drawn(falling / falling.sum()),
        "all to the same": np.tile(np.arange(config.top_k), (PATCHES, 1)),
    }


def measure(name: str, rounds: int) -> list[str]:
    """Markdown rows of one preset: the median of each setting, and the share that the arithmetic alone would take."""
    config, random = preset(name), np.random.default_rng(0)
    shape = (PATCHES, len(config.streams) * config.stream_channels, CELLS_PER_PATCH, CELLS_PER_PATCH)
    patches = random.standard_normal(shape, np.float32)
    weight = np.full((PATCHES, config.top_k), 1 / config.top_k, np.float32)
    runs = {skew: (session(config, sparse=True), index) for skew, index in routes(config, random).items()}
    dense = "every expert on every patch"
    runs[dense] = (session(config, sparse=False), runs["even"][1])
    times: dict[str, list[float]] = {setting: [] for setting in runs}
    for _ in range(rounds + 1):
        for setting, (one, index) in runs.items():
            start = time.process_time()
            one.run(None, {"patches": patches, "index": index, "weight": weight})
            times[setting].append(time.process_time() - start)
    medians = {setting: statistics.median(rows[1:]) for setting, rows in times.items()}
    share = medians[dense] * config.top_k / config.experts
    rows = [f"| `{name}` | {s} | {1e3 * m:.1f} | {m / share:.2f} |" for s, m in medians.items() if s != dense]
    return [*rows, f"| `{name}` | {dense} | {1e3 * medians[dense]:.1f} | |"]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.network.experts", description=__doc__.splitlines()[0])
    parser.add_argument("--presets", nargs="+", choices=PRESETS, default=PRESETS)
    parser.add_argument("--rounds", type=at_least_one, default=15)
    options = parser.parse_args()
    torch.set_num_threads(1)
    sys.stdout.write("| network | routing | CPU ms | of k / N_e of the dense run |\n|---|---|---|---|\n")
    for name in options.presets:
        sys.stdout.write("\n".join(measure(name, options.rounds)) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
