"""Each stage of the exported graph by itself, onnxruntime and torch in float32 against torch in float64.

The stages are the network's own modules. Where one begins and ends in the graph is found by value: of all tensors of a
run the one that equals the module's. A stage then gets the float64 network's tensors, rounded to float32, so that its
error is its own.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from few_blocks import little_full_network
from miniature_depthsplat import miniature_depthsplat
from onnx.utils import Extractor

from gapmes.export.graph import SceneGraph
from gapmes.export.routes import AMBIGUOUS_GAP
from gapmes.export.samples import random_scene
from gapmes.model.architectures import Network
from gapmes.model.checkpoint import load_checkpoint
from gapmes.service.network.contract import INPUTS

SQUARE, OBLONG = (64, 64), (48, 80)  # height and width
SAME = 1e-3  # of a tensor's largest value: what two runs in float32 differ by at most, and other tensors by far more


@dataclasses.dataclass(frozen=True)
class Stage:
    """What is asked of one: the largest error of each of its tensors as a share of that tensor's largest value, for the
    worse of both runtimes; how many tensors of its result the graph holds at least, the experts' numbers apart; how
    many of its arguments cut the graph: the others come from the contract's inputs, such as masks of ones; and which
    fields of its result have another limit."""

    limit: float
    compared: int
    cut: int
    others: Mapping[str, float] = dataclasses.field(default_factory=dict)


# Measured at most 6.3e-6, and 1.6e-5 in the depths from matching. The confidence is a softmax of logits up to 700, of
# which a rounding is 4e-5: 5.1e-5 there, over three scenes each of two and four views.
LIGHT = {
    "trunk": Stage(1e-5, 2, 1),
    "semantic": Stage(1e-5, 1, 1),
    "mono": Stage(1e-5, 1, 1),
    "depth": Stage(
        1e-5, 7, 6, others=dict.fromkeys(("quarter", "refined", "half", "full"), 5e-5) | {"confidence": 1e-4}
    ),
    "mixture": Stage(1e-5, 6, 4),
    "heads": Stage(1e-5, 6, 5),
}
# With neighbours by the cameras, and a depth map.
FULL = LIGHT | {"trunk": Stage(1e-5, 2, 3), "mono": Stage(1e-5, 2, 1)}
# Measured at most 1.8e-6, and 1.2e-5 in the depths from matching, with all before it.
DEPTHSPLAT = {
    "depth_predictor.backbone": Stage(5e-6, 3, 1),
    "depth_predictor.transformer": Stage(5e-6, 1, 1),
    "depth_predictor.pretrained": Stage(5e-6, 4, 1),
    "depth_predictor.mv_pyramid": Stage(5e-6, 2, 1),
    "depth_predictor.mono_pyramid": Stage(5e-6, 2, 1),
    "depth_predictor.depth_head.0": Stage(5e-6, 1, 1),
    "depth_predictor.depth_head.1": Stage(5e-6, 1, 1),
    "depth_predictor.upsampler": Stage(5e-6, 1, 10),
    "depth_predictor": Stage(5e-5, 11, 3),
    "feature_upsampler": Stage(5e-6, 1, 9),
    "gaussian_regressor": Stage(5e-6, 1, 1),
    "gaussian_head": Stage(5e-6, 1, 1),
}


def given_to(value: object) -> dict[str, object]:
    """The fields that a dataclass was constructed from, without those computed later."""
    return {field.name: getattr(value, field.name) for field in dataclasses.fields(value) if field.init}


def tensors(value: object) -> list[torch.Tensor]:
    """All tensors in nested tuples, mappings and dataclasses, in order."""
    if isinstance(value, torch.Tensor):
        return [value]
    if isinstance(value, dict):
        value = list(value.values())
    elif dataclasses.is_dataclass(value):
        value = list(given_to(value).values())
    return [tensor for item in value for tensor in tensors(item)] if isinstance(value, list | tuple) else []


def watched(network: Network, inputs, stages: Iterable[str]) -> dict[str, tuple[tuple, list[torch.Tensor]]]:
    """The arguments and results of every stage in a run."""
    found = {}
    hooks = [
        network.get_submodule(name).register_forward_hook(
            lambda _, given, out, name=name: found.update({name: (given, out)})
        )
        for name in stages
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
        return dataclasses.replace(value, **{name: cast(item, dtype) for name, item in given_to(value).items()})
    return value


def distance(one: np.ndarray, true: np.ndarray) -> float:
    """The largest difference, as a share of the largest true value."""
    return float(np.abs(one - true).max() / np.abs(true).max())


@contextmanager
def in_float64() -> Iterator[None]:
    """Tensors that the network creates itself, such as grids, are float64 too."""
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
    """A network with its graph and the size of its pictures, and its stages by the names of their modules."""

    network: Network
    graph: onnx.ModelProto
    size: tuple[int, int]
    stages: dict[str, Stage]


@pytest.fixture(scope="module", params=["light trunk", "full trunk", "DepthSplat"])
def exported(request: pytest.FixtureRequest) -> Exported:
    """The shipped network, and miniatures of preset `small` and of DepthSplat with random weights."""
    if request.param == "light trunk":
        network = load_checkpoint(request.getfixturevalue("checkpoint"))
        return Exported(network, request.getfixturevalue("small_graph"), SQUARE, LIGHT)
    if request.param == "full trunk":
        return Exported(little_full_network(), request.getfixturevalue("miniature_graph"), OBLONG, FULL)
    return Exported(miniature_depthsplat(2, 4), request.getfixturevalue("depthsplat_graph"), SQUARE, DEPTHSPLAT)


@pytest.mark.case("B1")
@pytest.mark.parametrize("views", [2, 4])
def test_every_stage_is_near_to_float64_in_both_runtimes(exported: Exported, views: int) -> None:
    network, graph = exported.network, exported.graph
    inputs = random_scene(views, *exported.size, seed=views)
    feed = {name: value.numpy() for name, value in zip(INPUTS, inputs.tensors(), strict=True)}
    run = everything(graph, feed)
    narrow = watched(network, inputs.tensors(), exported.stages)
    wide = copy.deepcopy(network).double()
    with in_float64():
        exact = watched(wide, cast(inputs.tensors(), torch.float64), exported.stages)
    for stage, asked in exported.stages.items():
        arguments = cast(exact[stage][0], torch.float32)
        with torch.no_grad():
            with torch.backends.mkldnn.flags(enabled=False):  # whose convolutions are off by four times as much
                by_torch = tensors(network.get_submodule(stage)(*arguments))
            with in_float64():
                result = wide.get_submodule(stage)(*cast(arguments, torch.float64))
        truth = tensors(result)
        pairs = zip(tensors(narrow[stage][0]), tensors(arguments), strict=True)
        given = {name: value.numpy() for one, value in pairs for name in names_of(one, run)}
        places = {
            place: found[0] for place, one in enumerate(tensors(narrow[stage][1])) if (found := names_of(one, run))
        }
        wanted = [*dict.fromkeys(places.values()), *(["expert_index"] if stage == "mixture" else [])]
        part = part_of(graph, run, list(given), wanted)
        by_graph = dict(zip(wanted, session_of(part).run(wanted, {**feed, **given}), strict=True))
        assert len(places) >= asked.compared
        assert sum(bool(names_of(one, run)) for one in tensors(narrow[stage][0])) >= asked.cut
        names = [one.name for one in dataclasses.fields(result)] if dataclasses.is_dataclass(result) else []
        fields = dict(enumerate(names)) if len(names) == len(truth) else {}
        assert {*asked.others} <= {fields.get(place) for place in places}
        for place, name in places.items():
            limit = asked.others.get(fields.get(place, ""), asked.limit)
            assert distance(by_graph[name], truth[place].numpy()) <= limit, (stage, place)
            assert distance(by_torch[place].numpy(), truth[place].numpy()) <= limit, (stage, place)
        if stage == "mixture":
            index = result.routing.expert_index.numpy().reshape(by_graph["expert_index"].shape)
            clear = (result.routing.margin.numpy() > AMBIGUOUS_GAP).reshape(index.shape[:2])
            assert clear.mean() > 0.9
            assert (by_graph["expert_index"][clear] == index[clear]).all()
