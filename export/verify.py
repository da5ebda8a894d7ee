"""Verify an exported file against torch; run as a process of its own, since onnxruntime keeps its memory.

`python -m gapmes.export.verify MODEL --checkpoint FILE --report FILE` prints one JSON event per case and exits with 0
when every case passed, 3 when one did not, 1 where a file cannot be used, such as another checkpoint than the model's.
With `--parent` it ends when that process does.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch

from gapmes.model.architectures import Network, config_from_json
from gapmes.model.weights_file import file_sha256
from gapmes.service.errors import InputError, ModelError
from gapmes.service.network.model_file import ModelFile, model_file
from gapmes.service.process.disk import replacing
from gapmes.service.process.machine import processor
from gapmes.service.process.output_file import check_output_file
from gapmes.service.process.with_parent import end_with_parent

from .cases import verification_cases
from .report import CaseResult, Report
from .tolerance import TOLERANCES, Tolerance
from .variant import Variant, load_variant
from .verification import verify

REFUSED = 1
FAILED = 3


def _what_it_must_be(file: ModelFile, checkpoint: Path) -> tuple[Tolerance, Network]:
    """The tolerance and the torch network for a file. Raises `ValueError` for another checkpoint than its own and for
    unusable metadata, `ModelError` for external weights of another graph, and `OSError`."""
    if file.info.precision not in TOLERANCES:
        raise ValueError(f"{file.path}: gapmes.precision is {file.info.precision!r}, need {' or '.join(TOLERANCES)}")
    if file.weights is not None:
        file.weights.check()
    if (found := file_sha256(checkpoint)) != file.info.weights_sha256:
        raise ValueError(
            f"{checkpoint} has the sha256 {found}, {file.path} was made from {file.info.weights_sha256}: give that file"
        )
    try:
        config = config_from_json(json.dumps(file.info.config))
        variant = Variant.of(config)
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{file.path} has a gapmes.config that this version cannot build: {error!r}") from error
    network = load_variant(checkpoint, variant).network
    said, need = (json.loads(each.to_json()) for each in (config, network.config))
    for name in sorted(said.keys() | need.keys()):
        pair = said.get(name), need.get(name)
        if pair[0] != pair[1]:
            raise ValueError(f"{file.path}: gapmes.config has {name} {pair[0]!r}, {checkpoint} has {pair[1]!r}")
    return TOLERANCES[file.info.precision], network


def _check_opset(model: onnx.ModelProto, file: ModelFile) -> None:
    """Raises `ValueError` unless the graph is of the opset that its metadata tell."""
    found = {entry.version for entry in model.opset_import if entry.domain in ("", "ai.onnx")}
    if found != {file.info.opset}:
        raise ValueError(f"{file.path}: gapmes.opset is {file.info.opset}, the graph has {sorted(found)}")


def versions() -> dict[str, str]:
    """What results depend on: versions of packages, and the processor with its instruction sets."""
    name, flags = processor()
    return {
        "processor": ", ".join([name, *flags]),
        "torch": torch.__version__,
        "onnx": onnx.__version__,
        "onnxruntime": onnxruntime.__version__,
        "numpy": np.__version__,
    }


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m gapmes.export.verify", description=__doc__.splitlines()[0])
    parser.add_argument("model", type=Path)
    parser.add_argument("--checkpoint", type=Path, required=True)
    parser.add_argument("--report", type=Path, required=True)
    parser.add_argument("--quick", action="store_true", help="two view counts instead of five")
    parser.add_argument("--parent", type=int, help="number of the process that starts this one, to end with")
    options = parser.parse_args(arguments)
    if options.parent is not None:
        end_with_parent(options.parent)
    try:
        file = model_file(options.model)
        tolerance, network = _what_it_must_be(file, options.checkpoint)
        model = onnx.load(options.model)
        _check_opset(model, file)
        check_output_file(options.report, field="report")
    except (ModelError, InputError, ValueError, OSError) as error:
        return _refused(error)
    cases = list(verification_cases(file.info.height, file.info.width, quick=options.quick))

    def tell(result: CaseResult) -> None:
        event = {"total": len(cases), "case": result.name, "views": result.views, "failures": result.failures}
        sys.stdout.write(json.dumps(event) + "\n")
        sys.stdout.flush()

    try:
        results = verify(model, network, cases, tolerance, tell)
        report = Report(file.info.file_sha256, file.info.precision, versions(), results)
        with replacing(options.report) as part:
            report.write(part)
    except (ModelError, OSError) as error:
        return _refused(error)
    return 0 if report.passed else FAILED


def _refused(error: Exception) -> int:
    sys.stderr.write(f"refused: {error}\n")
    return REFUSED


if __name__ == "__main__":
    sys.exit(main())
