"""Run one network in one runtime, in a process of its own: wait for a line, run once, answer with the seconds.

`python -m benchmarks.network.worker RUNTIME MODEL --checkpoint FILE --views V`; RUNTIME is one of `RUNTIMES`, or `peak`
for the matrix product that onnxruntime does best: large, with constant weights that it has packed.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..options import refusals_told

RUNTIMES = ("onnxruntime", "openvino-fp32", "openvino-bf16", "torch", "torch-compile")
PEAK_SHAPE = (650, 768, 3072)  # rows, inner, columns: a layer of ViT-B on two views
REPEATS_PEAK = 20


def runner(runtime: str, model: Path, checkpoint: Path, views: int) -> tuple[Callable[[], object], float]:
    """A function that runs once on one thread, and the operations of a run (0 if they are not counted)."""
    if runtime == "peak":
        return matrix_product()
    import torch

    torch.set_num_threads(1)
    from gapmes.export.samples import random_scene
    from gapmes.service.network.engine import Engine
    from gapmes.service.network.model_file import model_file

    info = model_file(model).info
    scene = random_scene(views, info.height, info.width, seed=views)
    if runtime not in ("torch", "torch-compile"):
        arrays = [value.numpy() for value in scene.tensors()]
        engine = Engine(model, threads=1, engine=runtime)  # type: ignore[arg-type]
        return lambda: engine.run(*arrays), 0.0
    from gapmes.export.graph import SceneGraph
    from gapmes.export.variant import Variant, load_variant
    from gapmes.model.architectures import config_from_json

    config = config_from_json(json.dumps(info.config))
    graph = SceneGraph(load_variant(checkpoint, Variant.of(config)).network).eval()
    call: Callable[..., object] = graph
    if runtime == "torch-compile":
        call = torch.compile(graph, dynamic=False)

    def run() -> object:
        with torch.inference_mode():
            return call(*scene.tensors())

    return run, operations(graph, scene.tensors()) if runtime == "torch" else 0.0


def operations(graph: object, inputs: tuple[object, ...]) -> float:
    """Multiply-adds of matrix products, attentions and convolutions, counted as two."""
    import torch
    from torch.utils.flop_counter import FlopCounterMode

    counter = FlopCounterMode(display=False)
    with torch.no_grad(), counter:
        graph(*inputs)  # type: ignore[operator]
    return float(counter.get_total_flops())


def matrix_product() -> tuple[Callable[[], object], float]:
    """onnxruntime's float32 matrix product with constant weights on one thread."""
    import onnx
    import onnxruntime as ort
    from onnx import TensorProto, helper, numpy_helper

    rows, inner, columns = PEAK_SHAPE
    random = np.random.default_rng(0)
    a = helper.make_tensor_value_info("a", TensorProto.FLOAT, [rows, inner])
    c = helper.make_tensor_value_info("c", TensorProto.FLOAT, [rows, columns])
    weights = numpy_helper.from_array(random.random((inner, columns), dtype=np.float32), "b")
    graph = helper.make_graph([helper.make_node("MatMul", ["a", "b"], ["c"])], "peak", [a], [c], [weights])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
    onnx.checker.check_model(model)
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    session = ort.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])
    feed = {"a": random.random((rows, inner), dtype=np.float32)}

    def run() -> None:
        for _ in range(REPEATS_PEAK):
            session.run(None, feed)

    return run, REPEATS_PEAK * 2.0 * rows * inner * columns


@refusals_told()
def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.network.worker", description=__doc__.splitlines()[0])
    parser.add_argument("runtime", choices=[*RUNTIMES, "peak"])
    parser.add_argument("model", type=Path)
    parser.add_argument("--checkpoint", type=Path, required=True)
    parser.add_argument("--views", type=int, required=True)
    options = parser.parse_args()
    run, flop = runner(options.runtime, options.model, options.checkpoint, options.views)
    run()  # compiles, prepares and allocates
    for _ in sys.stdin:
        wall, cpu = time.perf_counter(), time.process_time()
        run()
        row = {
            "cpu": time.process_time() - cpu,
            "wall": time.perf_counter() - wall,
            "operations": flop,
            "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        }
        sys.stdout.write(json.dumps(row) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
