"""Each stage of the exported graph by itself, onnxruntime and torch in float32 against torch in float64.

The stages are the network's own modules. Where one begins and ends in the graph is found by value: of all tensors of a
run the one that equals the module's. A stage then gets the float64 network's tensors, rounded to float32, so that its
error is its own.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from full_networks import miniature
from onnx.utils import Extractor

from gapmes.export.graph import SceneGraph
from gapmes.export.routes import AMBIGUOUS_GAP
from gapmes.export.samples import random_scene
from gapmes.model.checkpoint import load_checkpoint
from gapmes.model.network import GaPMeS
from gapmes.service.contract import INPUTS

SIZE, PATCHES = 64, 16
SAME = 1e-3  # of a tensor's largest value: what two runs in float32 differ by at most, and other tensors by far more
# Tensors of a stage's result that the graph holds too; the experts' numbers are compared by themselves.
COMPARED = {"trunk": 2, "semantic": 1, "mono": 1, "depth": 7, "mixture": 6, "heads": 6}
# Arguments of a stage that cut the graph; what does not comes from the contract's inputs, such as masks of ones.
CUT = {"trunk": 1, "semantic": 1, "mono": 1, "depth": 6, "mixture": 4, "heads": 5}
FULL_COMPARED, FULL_CUT = COMPARED | {"mono": 2}, CUT | {"trunk": 3}  # with a depth map, and neighbours by the cameras
# Of the largest value of each of a stage's tensors, for the worse of both runtimes. Measured at most 4.4e-6, but
# 4.6e-5 in the matching, whose scores are multiplied before a softmax.
LIMITS = {"trunk": 1e-5, "semantic": 1e-5, "mono": 1e-5, "depth": 1e-4, "mixture": 1e-5, "heads": 1e-5}


def tensors(value: object) -> list[torch.Tensor]:
    """Those in nested tuples, mappings and dataclasses, in order."""
    if isinstance(value, torch.Tensor):
        return [value]
    if isinstance(value, dict):
        value = list(value.values())
    elif dataclasses.is_dataclass(value):
        value = [getattr(value, field.name) for field in dataclasses.fields(value)]
    return [tensor for item in value for tensor in tensors(item)] if isinstance(value, list | tuple) else []


def watched(network: GaPMeS, inputs) -> dict[str, tuple[tuple, list[torch.Tensor]]]:
    """Arguments and results of every stage in a run."""
    found = {}
    hooks = [
        getattr(network, name).register_forward_hook(
            lambda _, given, out, name=name: found.update({name: (given, out)})
        )
        for name in LIMITS
    ]
    try:
        with torch.no_grad():
            SceneGraph(network)(*inputs)
    finally:
        for hook in hooks:
            hook.remove()
    return found


def cast(value: object, dtype: torch.dtype) -> object:
    """The same structure with its float tensors in another precision."""
    if isinstance(value, torch.Tensor):
        return value.to(dtype) if value.is_floating_point() else value
    if isinstance(value, dict):
        return {key: cast(item, dtype) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(cast(item, dtype) for item in value)
    if dataclasses.is_dataclass(value):
        fields = {field.name: cast(getattr(value, field.name), dtype) for field in dataclasses.fields(value)}
        return dataclasses.replace(value, **fields)
    return value


@contextmanager
def in_float64() -> Iterator[None]:
    """What the network makes by itself, such as grids, is float64 too."""
    torch.set_default_dtype(torch.float64)
    try:
        yield
    finally:
        torch.set_default_dtype(torch.float32)


def everything(model: onnx.ModelProto, feed: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Every tensor of a run by name."""
    open_model = onnx.ModelProto()
    open_model.CopyFrom(model)
    known = {output.name for output in model.graph.output}
    names = [name for node in model.graph.node for name in node.output if name and name not in known]
    open_model.graph.output.extend(onnx.helper.make_empty_tensor_value_info(name) for name in names)
    session = session_of(open_model)
    return dict(zip([output.name for output in session.get_outputs()], session.run(None, feed), strict=True))


def session_of(model: onnx.ModelProto) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    return onnxruntime.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])


def names_of(tensor: torch.Tensor, run: dict[str, np.ndarray]) -> list[str]:
    """Of the graph's tensor that equals it, and of its copies; none for a constant, which too many equal, and for what
    the graph does not hold."""
    value = tensor.numpy()
    if value.dtype != np.float32 or value.size < 2 or value.min() == value.max():
        return []
    alike = {name: other for name, other in run.items() if other.dtype == value.dtype and other.shape == value.shape}
    best = min(alike, key=lambda name: float(np.abs(alike[name] - value).max()), default=None)
    if best is None or np.abs(alike[best] - value).max() > SAME * np.abs(value).max():
        return []
    return [name for name, other in alike.items() if np.array_equal(other, alike[best])]


def part_of(model: onnx.ModelProto, run: dict[str, np.ndarray], given: list[str], wanted: list[str]) -> onnx.ModelProto:
    """The graph between tensors; the contract's inputs that it needs beside `given` are its inputs too."""
    known = {info.name for info in [*model.graph.value_info, *model.graph.input, *model.graph.output]}
    open_model = onnx.ModelProto()
    open_model.CopyFrom(model)
    for name in {*given, *wanted} - known:
        kind = onnx.helper.np_dtype_to_tensor_dtype(run[name].dtype)
        open_model.graph.value_info.append(onnx.helper.make_tensor_value_info(name, kind, run[name].shape))
    return Extractor(open_model).extract_model([*given, *(name for name in INPUTS if name not in given)], wanted)


@dataclasses.dataclass(frozen=True)
class Exported:
    """A network with its graph, and how many tensors of every stage are compared and cut at least."""

    network: GaPMeS
    graph: onnx.ModelProto
    compared: dict[str, int]
    cut: dict[str, int]


@pytest.fixture(scope="module", params=["light trunk", "full trunk"])
def exported(request: pytest.FixtureRequest) -> Exported:
    """The shipped network, and an untrained one of preset `small` with miniature ViTs."""
    if request.param == "light trunk":
        network = load_checkpoint(request.getfixturevalue("checkpoint"))
        return Exported(network, request.getfixturevalue("small_graph"), COMPARED, CUT)
    return Exported(miniature(), request.getfixturevalue("miniature_graph"), FULL_COMPARED, FULL_CUT)


@pytest.mark.case("B1")
@pytest.mark.parametrize("views", [2, 4])
def test_every_stage_is_near_to_float64_in_both_runtimes(exported: Exported, views: int) -> None:
    network, graph = exported.network, exported.graph
    inputs = random_scene(views, SIZE, SIZE, seed=views)
    feed = {name: value.numpy() for name, value in zip(INPUTS, inputs.tensors(), strict=True)}
    run = everything(graph, feed)
    narrow = watched(network, inputs.tensors())
    wide = copy.deepcopy(network).double()
    with in_float64():
        exact = watched(wide, cast(inputs.tensors(), torch.float64))
    for stage, limit in LIMITS.items():
        arguments = cast(exact[stage][0], torch.float32)
        with torch.no_grad():
            by_torch = tensors(getattr(network, stage)(*arguments))
            with in_float64():
                result = getattr(wide, stage)(*cast(arguments, torch.float64))
        truth = tensors(result)
        pairs = zip(tensors(narrow[stage][0]), tensors(arguments), strict=True)
        given = {name: value.numpy() for one, value in pairs for name in names_of(one, run)}
        places = {
            place: found[0] for place, one in enumerate(tensors(narrow[stage][1])) if (found := names_of(one, run))
        }
        wanted = [*dict.fromkeys(places.values()), *(["expert_index"] if stage == "mixture" else [])]
        part = part_of(graph, run, list(given), wanted)
        by_graph = dict(zip(wanted, session_of(part).run(wanted, {**feed, **given}), strict=True))
        assert len(places) >= exported.compared[stage]
        assert sum(bool(names_of(one, run)) for one in tensors(narrow[stage][0])) >= exported.cut[stage]
        for place, name in places.items():
            true = truth[place].numpy()
            found = (np.abs(one - true).max() / np.abs(true).max() for one in (by_graph[name], by_torch[place].numpy()))
            assert max(found) <= limit, (stage, place)
        if stage == "mixture":
            index = result.routing.expert_index.numpy().reshape(by_graph["expert_index"].shape)
            clear = (result.routing.margin.numpy() > AMBIGUOUS_GAP).reshape(index.shape[:2])
            assert clear.mean() > 0.9
            assert (by_graph["expert_index"][clear] == index[clear]).all()
