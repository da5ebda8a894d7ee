"""Export from torch to ONNX by the dynamo exporter, with a symbolic number of views, checks and shape inference."""

from __future__ import annotations

import ast
import gc
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import onnx
import onnx_ir as ir
import torch
from torch.export import Dim

from gapmes.model.allocation import lacks_memory
from gapmes.model.architectures import Network
from gapmes.service.cameras.view_checks import MAX_VIEWS, MIN_VIEWS
from gapmes.service.network.contract import INPUTS

from .fold import folded
from .graph import SceneGraph, folded_position_embeddings
from .linear_layers import deployed_linear_layers
from .metadata import OPSET
from .samples import random_scene
from .size import Size

_SCOPES = "pkg.torch.onnx.name_scopes"  # where the exporter says which modules a node comes from
TRACE_VIEWS = 3  # at 2 views a loop over other views would run once; every count is verified afterwards


def export_graph(network: Network, height: int, width: int) -> onnx.ModelProto:
    """The float32 graph of `network` for H x W pixels and 2 to 6 views, checked and shape-inferred.

    Raises `ValueError` for a size that is not a multiple of the network's step and for a network that torch cannot
    export, `onnx.checker.ValidationError` for a broken graph.
    """
    if misfit := Size(height, width).misfit(network.config.size_step):
        raise ValueError(misfit)
    graph = SceneGraph(network).eval()
    example = random_scene(TRACE_VIEWS, height, width, seed=0)
    views = Dim("V", min=MIN_VIEWS, max=MAX_VIEWS)
    shapes = {name: {0: views} for name in INPUTS}
    shapes["near_far"] = {}
    constants = folded_position_embeddings(network, height, width)
    with (
        torch.no_grad(),
        constants,
        deployed_linear_layers(network),
        _quiet_exporter(),
        _uncollected(),
        _exportable(height, width),
    ):
        program = torch.onnx.export(
            graph,
            example.tensors(),
            dynamo=True,
            input_names=list(INPUTS),
            output_names=list(graph.output_names),
            dynamic_shapes=shapes,
            opset_version=OPSET,
            verbose=False,
            optimize=False,
        )
    if program is None:
        raise ValueError("the exporter returned nothing")
    model = ir.to_proto(folded(program.model))
    strip_tracing_notes(model)
    onnx.checker.check_model(model, full_check=True)
    return onnx.shape_inference.infer_shapes(model, check_type=True, strict_mode=True)


@contextmanager
def _quiet_exporter() -> Iterator[None]:
    """Silence the exporter's warnings about optional packages and its own deprecations."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", module=r"torch\..*|copyreg")
            warnings.simplefilter("ignore", FutureWarning)
            warnings.simplefilter("ignore", DeprecationWarning)
            yield
    finally:
        logger.setLevel(level)


@contextmanager
def _exportable(height: int, width: int) -> Iterator[None]:
    """Raises `ValueError` in one line where the exporter fails, except for lack of memory."""
    try:
        yield
    except torch.onnx.OnnxExporterError as error:
        if lacks_memory(error):
            raise
        cause = error.__cause__ or error
        told = next(iter(str(cause).splitlines()), "")[:200]
        raise ValueError(
            f"torch {torch.__version__} cannot export this network for {height}x{width} px ({type(cause).__name__}: "
            f"{told}); try the size that it was trained at, 256x256 for gapmes, and the versions of gapmes[export]"
        ) from error


@contextmanager
def _uncollected() -> Iterator[None]:
    """Disable the garbage collector: during an export there is hardly any garbage, and the search takes 4 to 9 % of
    the time (81 s for `tiny`, 78 and 74 without). The peak of 860 MB is 60 MB higher without it."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()


def strip_tracing_notes(model: onnx.ModelProto) -> None:
    """Remove doc strings and metadata of nodes and values, in place: they hold source paths of the exporting machine.
    The module that a node belongs to is kept as a prefix of its name."""
    model.doc_string = ""
    model.graph.doc_string = ""
    for graph in [model.graph, *model.functions]:
        for node in graph.node:
            node.name = _with_module(node)
            node.doc_string = ""
            del node.metadata_props[:]
    for value in [*model.graph.value_info, *model.graph.input, *model.graph.output, *model.graph.initializer]:
        del value.metadata_props[:]
    del model.graph.metadata_props[:]


def _with_module(node: onnx.NodeProto) -> str:
    scopes = next((p.value for p in node.metadata_props if p.key == _SCOPES), "[]")
    *modules, _ = ast.literal_eval(scopes) or [""]
    return f"{modules[-1]}/{node.name}" if modules and modules[-1] else node.name
