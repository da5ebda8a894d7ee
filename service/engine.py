"""The network as an ONNX file: load it with onnxruntime, check that it is one of ours, run it, check what comes out."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .contract import INPUTS, OPTIONAL_OUTPUTS, REQUIRED_OUTPUTS
from .errors import ModelError
from .model_info import ModelInfo, parse_model_info
from .prepared_model import forget, prepared
from .shipped import shipped_model
from .threads import available_threads

os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")  # read by onnxruntime when it is first imported

Arrays = dict[str, NDArray]


class Engine:
    """A loaded model; `run` may be called from several threads at once."""

    def __init__(
        self, model: str | Path | None = None, *, threads: int | None = None, prepare: Path | None = None
    ) -> None:
        """Load `model` (default: the one in the package) for `threads` threads (default: the CPUs of this process).

        `prepare` is a folder for the optimised model, whose weights all processes share; without it each has its own.
        Raises `ModelError` where the file is missing, is no ONNX file, or is not a gapmes model of this format.
        """
        import onnxruntime as ort
        from onnxruntime.capi import onnxruntime_pybind11_state as native

        ort.disable_telemetry_events()
        self._failures = (native.Fail, native.RuntimeException, native.InvalidArgument, native.EPFail)
        path = shipped_model() if model is None else Path(model)
        file_sha256 = _sha256(path)
        self.threads = threads if threads is not None else available_threads()
        if self.threads < 1:
            raise ModelError(f"threads = {self.threads}, need at least 1", field="threads")
        damaged = (*self._failures, native.InvalidProtobuf, native.InvalidGraph, native.NotImplemented, native.NoModel)
        self._session: Any = None
        if prepare is not None and (optimised := prepared(path, file_sha256, prepare, self._options)) is not None:
            options = self._options()
            options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
            try:
                self._session = ort.InferenceSession(str(optimised), options, providers=["CPUExecutionProvider"])
            except damaged:
                forget(optimised)
        try:
            if self._session is None:
                self._session = ort.InferenceSession(str(path), self._options(), providers=["CPUExecutionProvider"])
        except damaged as error:
            raise ModelError(f"{path} cannot be loaded by onnxruntime: {error}", field="model") from error
        self.info = parse_model_info(self._session.get_modelmeta().custom_metadata_map, path, file_sha256)
        self.outputs = _checked_signature(self._session, path)

    def _options(self) -> Any:
        import onnxruntime as ort

        options = ort.SessionOptions()
        options.intra_op_num_threads = self.threads
        options.inter_op_num_threads = 1
        # the pattern reserves one block for all tensors of a run, more than they need at any one time; without it the
        # shipped network peaks at 0.27 GB with two views and 1.9 GB with six
        options.enable_mem_pattern = False
        options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
        options.use_deterministic_compute = True
        options.log_severity_level = 3
        return options

    def run(
        self,
        images: NDArray[np.float32],
        intrinsics: NDArray[np.float32],
        world_from_cam: NDArray[np.float32],
        near_far: NDArray[np.float32],
        patch_mask: NDArray[np.bool_],
    ) -> Arrays:
        """Run the network on V views.

        images (V, 3, H, W) float32 in [0, 1]; intrinsics (V, 3, 3) float32, rows normalised by width and height;
        world_from_cam (V, 4, 4) float32 relative to camera 0; near_far (2,) float32; patch_mask (V, P) bool, False
        leaves a patch out. Returns means (N, 3), scales (N, 3), rotations_wxyz (N, 4), opacities (N,), harmonics
        (N, K, 3), depth and confidence (V, H, W), expert_index (V, P, k) int64, expert_weight (V, P, k), task_weight
        (V, P, 4), route_margin (V, P); of the last four those are missing that the network does not have. The first
        V * H * W Gaussians belong to the pixels, view by view, row by row; others may follow.
        Same bits for the same input and thread count. Raises `ModelError` for other shapes and for outputs that are
        not finite.
        """
        info, views = self.info, len(images)
        feed = {
            "images": (images, np.float32, (views, 3, info.height, info.width)),
            "intrinsics": (intrinsics, np.float32, (views, 3, 3)),
            "world_from_cam": (world_from_cam, np.float32, (views, 4, 4)),
            "near_far": (near_far, np.float32, (2,)),
            "patch_mask": (patch_mask, np.bool_, (views, info.patches)),
        }
        for name, (value, dtype, shape) in feed.items():
            if value.dtype != dtype or value.shape != shape:
                raise ModelError(
                    f"is {value.dtype} {value.shape}, the model needs {np.dtype(dtype)} {shape}", field=name
                )
        try:
            values = self._session.run(list(self.outputs), {name: value for name, (value, _, _) in feed.items()})
        except self._failures as error:
            raise ModelError(f"onnxruntime failed on {views} views: {error}", field="model") from error
        outputs = dict(zip(self.outputs, values, strict=True))
        _check_outputs(outputs, views, info)
        return outputs


def _sha256(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise ModelError(
            f"{path} cannot be read: {error.strerror}",
            field="model",
            cure="make one with gapmes-export, or name another file",
        ) from error


def _checked_signature(session: Any, path: Path) -> tuple[str, ...]:
    """The contract's outputs that this file has; further ones are allowed. Raises `ModelError` for missing names."""
    inputs = [value.name for value in session.get_inputs()]
    outputs = [value.name for value in session.get_outputs()]
    if set(inputs) != set(INPUTS):
        raise ModelError(f"{path} has the inputs {sorted(inputs)}, need {sorted(INPUTS)}", field="model")
    missing = [name for name in REQUIRED_OUTPUTS if name not in outputs]
    if missing:
        raise ModelError(f"{path} lacks the outputs {', '.join(missing)}", field="model")
    return REQUIRED_OUTPUTS + tuple(name for name in OPTIONAL_OUTPUTS if name in outputs)


def _check_outputs(outputs: Arrays, views: int, info: ModelInfo) -> None:
    """Shapes against the contract, then finiteness, naming output, first row and count."""
    count = len(outputs["means"])
    coefficients = outputs["harmonics"].shape[1:2]
    chosen = outputs["expert_index"].shape[2:3] if "expert_index" in outputs else ()
    maps, patches = (views, info.height, info.width), (views, info.patches)
    shapes = {
        "means": (count, 3),
        "scales": (count, 3),
        "rotations_wxyz": (count, 4),
        "opacities": (count,),
        "harmonics": (count, *coefficients, 3),
        "depth": maps,
        "confidence": maps,
        "expert_index": (*patches, *chosen),
        "expert_weight": (*patches, *chosen),
        "task_weight": (*patches, 4),
        "route_margin": patches,
    }
    for name, value in outputs.items():
        if value.shape != shapes[name]:
            raise ModelError(f"output is {value.shape}, need {shapes[name]}", field=name)
    if count < views * info.height * info.width:
        raise ModelError(f"{count} Gaussians, need one per pixel: {views * info.height * info.width}", field="means")
    for name, value in outputs.items():
        _require(np.isfinite(value), name, "finite")
    _require(outputs["scales"] >= 0, "scales", "at least 0")
    _require((outputs["opacities"] >= 0) & (outputs["opacities"] <= 1), "opacities", "in [0, 1]")


def _require(ok: NDArray[np.bool_], name: str, need: str) -> None:
    if not ok.all():
        first = [int(i) for i in np.argwhere(~ok)[0]]
        raise ModelError(f"{int((~ok).sum())} of {ok.size} numbers are not {need}, first at {first}", field=name)
