"""Constant folding and deduplication after tracing.

The exporter's own optimiser also tries some forty rewrite patterns on every node, which took more than half of the time
of an export without any gain: onnxruntime has its own fusions, and runs either graph in the same time.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import onnx_ir as ir
from onnx_ir.passes import common
from onnxscript.optimizer import fold_constants

LARGEST = 2**20  # most elements of constants that are deduplicated
GATES = "network.mixture.gates."  # verification gives each constant of the gates a value of its own (gate_settings.py)


def folded(model: ir.Model) -> ir.Model:
    """`model`, changed in place."""
    common.InlinePass()(model)
    fold_constants(model)
    _skip_idle_transposes(model.graph)
    ir.passes.Sequential(
        common.RemoveUnusedNodesPass(),
        common.RemoveUnusedFunctionsPass(),
        common.RemoveUnusedOpsetsPass(),
        common.LiftConstantsToInitializersPass(lift_all_constants=True, size_limit=0),
    )(model)
    with _without_gates(model.graph):
        common.DeduplicateInitializersPass(size_limit=LARGEST)(model)
    ir.passes.Sequential(
        common.CommonSubexpressionEliminationPass(),
        common.OutputFixPass(),
        common.NameFixPass(),
    )(model)
    return model


def _skip_idle_transposes(graph: ir.Graph) -> None:
    """Bypass identity transposes, which tracing adds to scatter operations; each would copy its input."""
    for node in graph:
        order = node.attributes.get("perm")
        if node.op_type == "Transpose" and order is not None and sorted(order.as_ints()) == list(order.as_ints()):
            given, result = node.inputs[0], node.outputs[0]
            assert given is not None
            if not result.is_graph_output():
                result.replace_all_uses_with(given)


@contextmanager
def _without_gates(graph: ir.Graph) -> Iterator[None]:
    """Within the context the gates' constants are no initializers of the graph, so that none is merged with an equal
    one, such as the zeros of an untrained gate; the order of initializers stays."""
    order = list(graph.initializers)
    gates = {name: graph.initializers.pop(name) for name in order if name.startswith(GATES)}
    try:
        yield
    finally:
        kept = gates | {name: graph.initializers.pop(name) for name in tuple(graph.initializers)}
        for name in order:
            if name in kept:
                graph.initializers.add(kept[name])
