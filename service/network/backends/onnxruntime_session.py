"""The network in onnxruntime, which is what the package needs and the default."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ...errors import ModelError
from ..model_file import ModelFile
from ..prepared_model import forget, prepared
from .choice import Sides

_CPU = ["CPUExecutionProvider"]
_sharing = threading.Lock()
_REGION_BYTES = 4 << 20  # a region goes back when all of it is free, which one output that is still read prevents


def session_options(threads: int) -> Any:
    """onnxruntime's `SessionOptions` for `threads` threads."""
    import onnxruntime as ort

    _share_arena()
    options = ort.SessionOptions()
    options.add_session_config_entry("session.use_env_allocators", "1")
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    # the pattern reserves one block for all tensors of a run, more than they need at any one time
    options.enable_mem_pattern = False
    # a plan that hands one tensor's block to a later one of the same size holds it in between as well: with two views
    # 118 MB are in use with it and 67 MB without, in the same time. Without, a process that does nothing but run the
    # shipped network peaks at 0.20 GB with two views and 0.66 GB with six
    options.enable_mem_reuse = False
    options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
    options.use_deterministic_compute = True
    options.log_severity_level = 3
    return options


def _share_arena() -> None:
    """One arena for all sessions of the process that ask for it, which grows by small regions: with regions that double
    in size the outputs of two views held 16 MB more than they need. A program around us that has set up one of its own
    keeps it, where onnxruntime says so."""
    with _sharing:
        _register_arena()


@cache
def _register_arena() -> None:
    import onnxruntime as ort

    sizes = {"max_mem": 0, "max_power_of_two_extend_bytes": _REGION_BYTES}
    where = ort.OrtMemoryInfo("Cpu", ort.OrtAllocatorType.ORT_ARENA_ALLOCATOR, 0, ort.OrtMemType.DEFAULT)
    with suppress(RuntimeError):  # there is one already
        ort.create_and_register_allocator(where, ort.OrtArenaCfg(sizes))


def run_failures() -> tuple[type[Exception], ...]:
    """What onnxruntime raises where it fails on a graph's inputs."""
    from onnxruntime.capi import onnxruntime_pybind11_state as native

    return native.Fail, native.RuntimeException, native.InvalidArgument, native.EPFail


def load_failures() -> tuple[type[Exception], ...]:
    """What onnxruntime raises for a graph that it cannot load."""
    from onnxruntime.capi import onnxruntime_pybind11_state as native

    return (*run_failures(), native.InvalidProtobuf, native.InvalidGraph, native.NotImplemented, native.NoModel)


class OnnxRuntimeSession:
    """A session of onnxruntime on the CPU, see `Session`."""

    def __init__(self, file: ModelFile, threads: int, prepare: Path | None) -> None:
        """Load `file`; with the folder `prepare` as it is optimised there, weights mapped. Raises `ModelError`."""
        import onnxruntime as ort

        ort.disable_telemetry_events()
        self.failures = run_failures()
        damaged = load_failures()
        session: Any = None
        sha256 = file.info.file_sha256
        make_options = partial(session_options, threads)
        if prepare is not None and (optimised := prepared(file.path, sha256, prepare, make_options)) is not None:
            options = make_options()
            options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
            try:
                session = ort.InferenceSession(str(optimised), options, providers=_CPU)
            except damaged:
                forget(optimised)
        try:
            if session is None:
                session = ort.InferenceSession(str(file.path), make_options(), providers=_CPU)
        except damaged as error:
            raise ModelError(f"{file.path} cannot be loaded by onnxruntime: {error}", field="model") from error
        self.native = session
        # what a run needed goes back to the system after it, not to the next run: everything after the network would
        # come on top of it
        self._run_options = ort.RunOptions()
        self._run_options.add_run_config_entry("memory.enable_memory_arena_shrinkage", "cpu:0")
        self.inputs: Mapping[str, Sides] = {value.name: _sides(value.shape) for value in session.get_inputs()}
        self.outputs: Sequence[str] = [value.name for value in session.get_outputs()]

    def run(self, names: Sequence[str], feed: dict[str, NDArray]) -> list[Any]:
        """The outputs of these names."""
        return self.native.run(list(names), feed, self._run_options)


def _sides(shape: Sequence[int | str | None]) -> Sides:
    """A side that may be any has a name, or none."""
    return tuple(side if isinstance(side, int) else None for side in shape)
