"""Verify an exported file against torch; run as a process of its own, since onnxruntime keeps its memory.

`python -m gapmes.export.verify MODEL --checkpoint FILE --report FILE` prints one JSON event per case and exits with 0
when every case passed, 3 when one did not.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch

from gapmes.model.checkpoint import file_sha256, load_checkpoint
from gapmes.model.network import GaPMeS

from .cases import Case, GateSetting, gate_values, verification_cases, with_gates
from .compare import ambiguous_routes, deviation, quaternions_aligned, route_agreement
from .contract import INPUTS, ROUTING_OUTPUTS, output_names
from .graph import SceneGraph
from .report import CaseResult, Report
from .tolerance import TOLERANCES, Tolerance

FAILED = 3


def verify(
    model: onnx.ModelProto,
    network: GaPMeS,
    cases: Iterable[Case],
    tolerance: Tolerance,
    on_case: Callable[[CaseResult], None] = lambda _: None,
) -> list[CaseResult]:
    """Run every case through both runtimes, one graph at a time."""
    results = []
    gated = network.mixture.gates is not None
    trained = gate_values(network, "as trained") if gated else {}
    for gates, group in itertools.groupby(cases, key=lambda case: case.gates):
        if gates != "as trained" and not gated:
            continue  # a network without gates has nothing to set
        session = _session(model, network, gates)
        for case in group:
            results.append(_run(case, session, network, tolerance))
            on_case(results[-1])
        network.load_state_dict(trained, strict=False)
    return results


def _session(model: onnx.ModelProto, network: GaPMeS, gates: GateSetting) -> onnxruntime.InferenceSession:
    """A session of the graph under a gate setting; sets the torch network's gates alike."""
    if gates != "as trained":
        values = gate_values(network, gates)
        model = with_gates(model, values)
        network.load_state_dict(values, strict=False)
    options = onnxruntime.SessionOptions()
    options.inter_op_num_threads = 1
    return onnxruntime.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])


def _run(case: Case, session: onnxruntime.InferenceSession, network: GaPMeS, tolerance: Tolerance) -> CaseResult:
    graph = SceneGraph(network).eval()
    names = output_names(with_routing=graph.with_routing)
    logits = _GateLogits(network)
    with torch.no_grad(), logits:
        expected = [value.numpy() for value in graph(*case.inputs.tensors())]
    feed = {name: value.numpy() for name, value in zip(INPUTS, case.inputs.tensors(), strict=True)}
    actual = session.run(list(names), feed)
    reference = dict(zip(names, expected, strict=True))
    outputs, failures = {}, []
    values = dict(zip(names, actual, strict=True))
    values["rotations_wxyz"] = quaternions_aligned(values["rotations_wxyz"], reference["rotations_wxyz"])
    routes = None
    if graph.with_routing:
        index, _, task = (values[name] for name in ROUTING_OUTPUTS)
        routes = route_agreement(
            index,
            reference["expert_index"],
            task,
            reference["task_weight"],
            ambiguous_routes(logits.expert, logits.task, network.config.top_k),
            case.inputs.patch_mask.numpy(),
        )
        allowed = tolerance.unambiguous_flips * routes.patches
        if routes.flipped_unambiguous > allowed:
            failures.append(f"routes: {routes.flipped_unambiguous} of {routes.patches} differ, {allowed:.0f} allowed")
    # a patch on another route changes its own pixels and, through one 3x3 convolution, those around it
    excused = 4 * routes.flipped / max(routes.patches, 1) if routes else 0.0
    for name in names:
        if name == "expert_index":
            continue
        try:
            found = deviation(values[name], reference[name])
        except ValueError as error:
            failures.append(f"{name}: {error}")
            continue
        outputs[name] = found
        if not found.finite:
            failures.append(f"{name}: not finite")
        elif found.p99 > tolerance.p99 and excused < 0.01:
            failures.append(f"{name}: p99 {found.p99:.2e}, allowed {tolerance.p99:.0e}")
        elif found.jumps > tolerance.jumps + excused:
            failures.append(f"{name}: {found.jumps:.2e} of it jumps, allowed {tolerance.jumps + excused:.0e}")
    return CaseResult(case.name, case.gates, case.views, outputs, routes, failures)


class _GateLogits:
    """Records both gates' logits of one torch run."""

    expert: np.ndarray
    task: np.ndarray

    def __init__(self, network: GaPMeS) -> None:
        self._gates = network.mixture.gates

    def __enter__(self) -> None:
        self._hooks = []
        if self._gates is None:
            return
        for name, gate in (("expert", self._gates.expert_gate), ("task", self._gates.task_gate)):
            self._hooks.append(
                gate.register_forward_hook(lambda _m, _i, out, name=name: setattr(self, name, out.numpy()))
            )

    def __exit__(self, *_: object) -> None:
        for hook in self._hooks:
            hook.remove()


def versions() -> dict[str, str]:
    """Versions that a figure depends on."""
    return {
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
    options = parser.parse_args(arguments)
    model = onnx.load(options.model)
    metadata = {p.key: p.value for p in model.metadata_props}
    precision = metadata["gapmes.precision"]
    height, width = int(metadata["gapmes.height"]), int(metadata["gapmes.width"])
    network = load_checkpoint(options.checkpoint)
    cases = list(verification_cases(height, width, quick=options.quick))

    def tell(result: CaseResult) -> None:
        event = {"total": len(cases), "case": result.name, "views": result.views, "failures": result.failures}
        sys.stdout.write(json.dumps(event) + "\n")
        sys.stdout.flush()

    results = verify(model, network, cases, TOLERANCES[precision], tell)
    report = Report(file_sha256(options.model), precision, versions(), results)
    report.write(options.report)
    return 0 if report.passed else FAILED


if __name__ == "__main__":
    sys.exit(main())
