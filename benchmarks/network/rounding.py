"""Measure how far float32 itself is from float64: an exported file and torch, each against torch in float64.

`python -m benchmarks.network.rounding MODEL.onnx=CHECKPOINT [--cases NAME …] [--views N …]` runs the cases of
verification with trained gates. If torch's own float32 error is larger than the file's difference from torch, no file
can come closer to the truth by coming closer to torch.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping

import numpy as np
import onnx
import onnxruntime
import torch
from numpy.typing import NDArray

from gapmes.export.cases import Case, verification_cases
from gapmes.export.deviations import deviations
from gapmes.export.graph import evaluated
from gapmes.export.routes import flipped_patches
from gapmes.export.variant import Variant, load_variant
from gapmes.model.architectures import config_from_json
from gapmes.service.network.contract import INPUTS

from ..options import model_files, refusals_told, view_count

Outputs = dict[str, NDArray[np.generic]]


def worst(values: Outputs, reference: Outputs, case: Case) -> str:
    """The output with the largest 99th percentile, in units of its largest magnitude, outside changed routes."""
    flipped = flipped_patches(values, reference, case.inputs.patch_mask.numpy())
    found = deviations(values, reference, flipped, case)
    name = max(found, key=lambda one: found[one].p99)
    return f"{found[name].p99:.1e} ({name})"


def session_outputs(session: onnxruntime.InferenceSession, names: Mapping[str, object], case: Case) -> Outputs:
    """The exported file's outputs of these `names`."""
    feed = {name: value.numpy() for name, value in zip(INPUTS, case.inputs.tensors(), strict=True)}
    return dict(zip(names, session.run(list(names), feed), strict=True))


@refusals_told()
def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.network.rounding", description=__doc__.splitlines()[0])
    parser.add_argument("model", type=model_files(), metavar="MODEL.onnx=CHECKPOINT")
    parser.add_argument("--cases", nargs="+", default=["random", "sample", "noise"])
    parser.add_argument("--views", nargs="+", type=view_count, default=[2, 3])
    options = parser.parse_args()
    file, checkpoint = options.model
    metadata = {p.key: p.value for p in onnx.load(file, load_external_data=False).metadata_props}
    cases = verification_cases(int(metadata["gapmes.height"]), int(metadata["gapmes.width"]))
    trained = [case for case in cases if case.gates == "as trained"]
    if unknown := set(options.cases) - {case.name for case in trained}:
        parser.error(f"no case is named {', '.join(sorted(unknown))}")
    chosen = [case for case in trained if case.name in options.cases and case.views in options.views]
    if not chosen:
        parser.error("no case of these names has such a number of views")
    network = load_variant(checkpoint, Variant.of(config_from_json(metadata["gapmes.config"]))).network
    session = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])
    lines = [
        "| case | views | onnxruntime beside torch | torch beside float64 | onnxruntime beside float64 |",
        "|---" * 5 + "|",
    ]
    sys.stdout.write("\n".join(lines) + "\n")
    for case in chosen:
        exact = evaluated(network, case.inputs, torch.float64)
        single = evaluated(network, case.inputs, torch.float32)
        given = session_outputs(session, single, case)
        cells = [worst(given, single, case), worst(single, exact, case), worst(given, exact, case)]
        sys.stdout.write(f"| {case.name} | {case.views} | {' | '.join(cells)} |\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
