"""Every case of the verification in onnxruntime and in torch, compared output by output."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
import onnx
import onnxruntime
import torch

from gapmes.model.architectures import Network
from gapmes.model.config import ModelConfig
from gapmes.model.overflow import overflow
from gapmes.service.errors import ModelError
from gapmes.service.network.backends.onnxruntime_session import load_failures, run_failures
from gapmes.service.network.contract import INPUTS, REQUIRED_OUTPUTS

from .cases import Case
from .deviations import LEFT, Outputs, beside_float64, deviations, share_left, untouched_elements
from .gate_settings import GateSetting, gate_values, with_gates
from .graph import SceneGraph, evaluated
from .pictures import PictureAgreement, picture_agreement
from .report import CaseResult
from .routes import RouteAgreement, agreement, ambiguous, flipped_patches
from .tolerance import Tolerance


def verify(
    model: onnx.ModelProto,
    network: Network,
    cases: Iterable[Case],
    tolerance: Tolerance,
    on_case: Callable[[CaseResult], None] = lambda _: None,
) -> list[CaseResult]:
    """Run every case in both runtimes, in order; `cases` must be grouped by gate setting, one session for each. Raises
    `ModelError` for a graph that onnxruntime cannot load or run."""
    results = []
    gated = network.gates is not None
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


def _session(model: onnx.ModelProto, network: Network, gates: GateSetting) -> onnxruntime.InferenceSession:
    """A session of the graph under a gate setting, which is applied to the torch network too."""
    if gates != "as trained":
        values = gate_values(network, gates)
        model = with_gates(model, values)
        network.load_state_dict(values, strict=False)
    options = onnxruntime.SessionOptions()
    options.inter_op_num_threads = 1
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")  # torch runs in turn on the same cores
    try:
        return onnxruntime.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])
    except load_failures() as error:
        raise ModelError(f"onnxruntime cannot load the graph: {error}", field="model") from error


def _run(case: Case, session: onnxruntime.InferenceSession, network: Network, tolerance: Tolerance) -> CaseResult:
    """Compare one case, as far as its outputs can be compared."""
    if case.flat:
        tolerance = tolerance.for_flat_images()
    elif case.undetermined:
        tolerance = tolerance.for_undetermined_matching()
    result = CaseResult(case.name, case.gates, case.views)
    logits = _GateLogits(network)
    reference, failures = _of_torch(case, network, logits)
    if failures:
        return replace(result, failures=failures)
    values = _of_file(case, session, tuple(reference))
    shapes = {n: (_shape(values[n]), _shape(reference[n])) for n in reference}
    if wrong := [f"{n}: is {found}, need {need}" for n, (found, need) in shapes.items() if found != need]:
        return replace(result, failures=wrong)
    kept = case.inputs.patch_mask.numpy()
    flipped = flipped_patches(values, reference, kept)
    if tuple(reference) != REQUIRED_OUTPUTS:
        trained = case.gates == "as trained"
        undecided = logits.undecided(network).reshape(kept.shape) if trained else np.zeros_like(kept)
        routes = agreement(flipped, undecided, kept)
        result, failures = replace(result, routes=routes), _route_failures(routes, trained, tolerance)
        if (left := share_left(flipped, reference)) < LEFT:
            failures.append(f"routes: only {left:.0%} of the values are left to compare, need {LEFT:.0%}")
            return replace(result, failures=failures)
    result = replace(result, outputs=deviations(values, reference, flipped, case))
    finite = all(found.finite for found in result.outputs.values())
    if finite and tolerance.rounding_factor is not None and (beyond := _beyond(result, tolerance)):
        exact = beside_float64(values, reference, network, case)
        result = replace(result, beside_float64={name: exact[name] for name, _, _ in beyond})
    failures += _value_failures(result, tolerance)
    if case.name == "sample" and finite:
        picture = picture_agreement(values, reference, untouched_elements(flipped, reference)["gaussian"], case)
        result = replace(result, picture=picture)
        failures += picture_failures(picture, tolerance)
    return replace(result, failures=failures)


def _of_torch(case: Case, network: Network, logits: _GateLogits) -> tuple[Outputs, list[str]]:
    """The outputs of the torch network, with its gates' logits recorded, or failures where it gives no finite ones."""
    try:
        with logits:
            outputs = evaluated(network, case.inputs, torch.float32)
    except (IndexError, RuntimeError):
        if told := _torch_overflow(network, case):
            return {}, told
        raise
    if all(np.isfinite(value).all() for value in outputs.values()):
        return outputs, []
    return {}, _torch_overflow(network, case) or ["torch: numbers that are not finite"]


def _of_file(case: Case, session: onnxruntime.InferenceSession, names: tuple[str, ...]) -> Outputs:
    """The same outputs of the exported file. Raises `ModelError` where onnxruntime fails, as for a missing one."""
    feed = {name: value.numpy() for name, value in zip(INPUTS, case.inputs.tensors(), strict=True)}
    try:
        return dict(zip(names, session.run(list(names), feed), strict=True))
    except run_failures() as error:
        raise ModelError(f"onnxruntime cannot run the graph: {error}", field="model") from error


def _shape(value: np.ndarray) -> str:
    return f"{value.dtype} {value.shape}"


def _route_failures(routes: RouteAgreement, trained: bool, tolerance: Tolerance) -> list[str]:
    """Routes may differ with trained gates only: under a gate setting both runtimes have equal logits, and ties go to
    the lowest index in both."""
    allowed = tolerance.spare_flips + tolerance.unambiguous_flips * routes.patches if trained else 0
    if routes.flipped_unambiguous <= allowed:
        return []
    return [f"routes: {routes.flipped_unambiguous} of {routes.patches} differ, {allowed:.0f} allowed"]


def _beyond(result: CaseResult, tolerance: Tolerance) -> list[tuple[str, str, float]]:
    """Output, kind of error and limit, for every error beyond its limit."""
    return [
        (name, what, limit)
        for name, found in result.outputs.items()
        for what, limit in tolerance.of_output(name).items()
        if not getattr(found, what) <= limit
    ]


def _value_failures(result: CaseResult, tolerance: Tolerance) -> list[str]:
    """Outputs that are not finite, and errors beyond a limit that torch's own distance from float64 does not excuse."""
    failures = [f"{name}: not finite" for name, found in result.outputs.items() if not found.finite]
    for name, what, limit in _beyond(result, tolerance):
        failure = f"{name}: {what} {getattr(result.outputs[name], what):.2e}, allowed {limit:.1e}"
        if exact := result.beside_float64.get(name):
            ours, theirs = getattr(exact.exported, what), getattr(exact.torch, what)
            allowed = tolerance.of_rounding(what, theirs)
            if exact.torch.finite and ours <= max(limit, allowed):
                continue
            failure += f"; beside float64 {ours:.2e}, where torch has {theirs:.2e}, allowed {allowed:.1e}"
        failures.append(failure)
    return failures


def _torch_overflow(network: Network, case: Case) -> list[str]:
    """A failure that names the layer where torch itself overflows, if it does."""
    graph = SceneGraph(network).eval()
    found = overflow(network, lambda: graph(*case.inputs.tensors()))
    return [f"torch: {found}"] if found else []


def picture_failures(found: PictureAgreement, tolerance: Tolerance) -> list[str]:
    """Failures of the whole picture, of the one without jumps, and of the share of jumped Gaussians."""
    failures = []
    for what, psnr, least in (
        ("picture", found.psnr, tolerance.picture_psnr),
        ("picture without jumps", found.without_jumps, tolerance.smooth_picture_psnr),
    ):
        if not psnr >= least:
            failures.append(f"{what}: {psnr:.1f} dB, need {least:.0f}")
    if not found.jumped <= tolerance.jumps:
        failures.append(f"picture: {found.jumped:.2e} of the Gaussians jumped, allowed {tolerance.jumps:.1e}")
    return failures


class _GateLogits:
    """A context that records the logits of both gates in a torch run."""

    def __init__(self, network: Network) -> None:
        gates = network.gates
        both = () if gates is None else (("expert", gates.expert_gate), ("task", gates.task_gate))
        self._gates = [(name, gate) for name, gate in both if gate is not None]
        self.found: dict[str, np.ndarray] = {}

    def __enter__(self) -> None:
        self._hooks = [
            gate.register_forward_hook(lambda _m, _i, out, name=name: self.found.__setitem__(name, out.numpy()))
            for name, gate in self._gates
        ]

    def __exit__(self, *_: object) -> None:
        for hook in self._hooks:
            hook.remove()

    def undecided(self, network: Network) -> np.ndarray:
        """(M,) mask of patches whose route rounding may decide."""
        assert isinstance(network.config, ModelConfig)  # the only one with gates
        deciding = {"expert": network.config.top_k, "task": 1}
        return np.any([ambiguous(logits, deciding[name]) for name, logits in self.found.items()], axis=0)
