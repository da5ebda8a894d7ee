"""int8 quantisation of the transformers' linear layers; gates, convolutions and what decides matching stay float32.

Weights are quantised per output channel at export, activations per tensor at run time. The gates are exact, but their
inputs come from quantised layers: some routes change, and the report counts them.
"""

from __future__ import annotations

import logging
import re
import tempfile
from pathlib import Path

import onnx
from onnxruntime.quantization import QuantType, quantize_dynamic

from gapmes.service.process.ending import unfinished

TRANSPOSED = "_Transposed"  # the quantiser turns Gemm with a transposed weight into MatMul and renames the weight
# Substrings of the names of nodes and constants that stay float32: the gates, and the whole cross-view transformer of
# the full trunk and of DepthSplat. Of the light trunk's cross-view transformer it is the attention of the last block
# alone: in 8 bits it would send a sixth of a grey image's patches to other experts. With that whole transformer in
# float32 a file is more accurate (weights of the model card's fourth run: no route of black and grey images changed,
# pictures agreed to 81 instead of 71 dB), and has 88 instead of 84 % of the bytes of the float32 file.
_FLOAT32_PARTS = ("mixture.gates.", ".transformer.layers.")
_ATTENTION = ("query_", "key_value_", "out_")
_CROSS_VIEW_BLOCK = re.compile(r"trunk\.cross_view\.(\d+)\.")


def quantised(model: onnx.ModelProto) -> onnx.ModelProto:
    """The int8 variant of a float32 graph. Raises `ValueError` when nothing was quantised, or a float32 part was."""
    with tempfile.TemporaryDirectory(prefix="gapmes-") as folder, unfinished(Path(folder)):
        source, target = Path(folder, "fp32.onnx"), Path(folder, "int8.onnx")
        bare = onnx.ModelProto()
        bare.CopyFrom(model)
        del bare.graph.value_info[:]  # the quantiser turns Gemm into MatMul, after which recorded shapes are stale
        onnx.save(bare, source)
        before = logging.root.manager.disable
        # it advises a preparation that the exporter has done already
        logging.disable(max(before, logging.WARNING))
        try:
            _quantise(source, target, _float32_nodes(model))
        finally:
            logging.disable(before)
        result = onnx.load(target)
    integer = [node for node in result.graph.node if node.op_type == "MatMulInteger"]
    if not integer:
        raise ValueError("the graph has no linear layer with constant weights to quantise")
    kept = {i.name.removesuffix(TRANSPOSED) for i in result.graph.initializer}
    parts = _float32_parts(model)
    lost = [i.name for i in model.graph.initializer if any(part in i.name for part in parts) and i.name not in kept]
    if lost:
        raise ValueError(f"constants that must stay float32 were quantised: {lost}")
    onnx.checker.check_model(result)
    return result


def _quantise(source: Path, target: Path, float32_nodes: list[str]) -> None:
    quantize_dynamic(
        source,
        target,
        op_types_to_quantize=["MatMul", "Gemm"],
        per_channel=True,
        reduce_range=True,  # u8 x s8 products saturate on processors without VNNI; 7 bits give the same everywhere
        weight_type=QuantType.QInt8,
        nodes_to_exclude=float32_nodes,
        extra_options={"MatMulConstBOnly": True},
    )


def _float32_nodes(model: onnx.ModelProto) -> list[str]:
    """Names of the nodes that stay float32: those of the float32 parts, and matrix products outside of linear layers,
    such as window means, which belong to modules that contain others."""
    modules = {n.name.rpartition("/")[0] for n in model.graph.node}
    parts = _float32_parts(model)
    holders = {module[:at] for module in modules for at, letter in enumerate(module) if letter == "."}
    names = [
        n.name
        for n in model.graph.node
        if n.name.rpartition("/")[0] in holders or any(part in name for part in parts for name in (n.name, *n.input))
    ]
    return names + [f"{name}_MatMul" for name in names]  # the quantiser renames Gemm nodes so


def _float32_parts(model: onnx.ModelProto) -> tuple[str, ...]:
    """Substrings of the names of nodes and constants that stay float32, for the blocks of this graph."""
    blocks = {int(found[1]) for i in model.graph.initializer if (found := _CROSS_VIEW_BLOCK.search(i.name))}
    last = [f"trunk.cross_view.{max(blocks)}.{part}" for part in _ATTENTION] if blocks else []
    return (*_FLOAT32_PARTS, *last)
