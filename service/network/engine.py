"""The network as an ONNX file: loaded into a runtime, checked against the contract, and run with checked outputs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..arguments import file_path, shown, whole_number
from ..errors import MORE_MEMORY, ModelError
from ..process.threads import MAX_THREADS, available_threads
from ..shipped import shipped_model
from .backends.choice import DEFAULT_ENGINE, EngineName, Session, Sides, checked_engine, identity, made_by, open_session
from .contract import INPUTS, OPTIONAL_OUTPUTS, REQUIRED_OUTPUTS
from .model_file import model_file
from .model_info import ModelInfo

_OUT_OF_MEMORY = ("bad_alloc", "Failed to allocate memory")  # in the words of the runtimes, which have no type for it

BF16 = 2**-7  # its step at 1: shares that an engine of that precision adds up may be beyond 1 by as much

Arrays = dict[str, NDArray]


class Engine:
    """A loaded model; `run` may be called from several threads at once."""

    def __init__(
        self,
        model: str | Path | None = None,
        *,
        threads: int | None = None,
        prepare: str | Path | None = None,
        engine: EngineName = DEFAULT_ENGINE,
    ) -> None:
        """Load `model` (default: the one in the package) for `threads` threads (default: the CPUs of this process).

        `prepare` is a folder for the model as optimised by onnxruntime, whose weights all processes share; without it
        each process has its own. `engine` chooses runtime and precision. Raises `ModelError` for a file or weights
        that are missing or damaged, for one that is no gapmes model of this format, and for a graph whose input shapes
        contradict its metadata, and `InputError` for what is no path.
        """
        engine = checked_engine(engine)
        file = model_file(shipped_model() if model is None else file_path(model, "model", "give an ONNX file"))
        folder = None if prepare is None else file_path(prepare, "prepare", "name a folder, or leave it out")
        count = available_threads() if threads is None else whole_number(threads)
        if count is None or not 1 <= count <= MAX_THREADS:
            need = f"need a whole number from 1 to {MAX_THREADS}"
            raise ModelError(f"threads = {shown(threads)}, {need}", field="threads")
        self.threads = count
        if file.weights is not None:
            file.weights.check()
        self.made_by = made_by(engine)
        self._session = open_session(engine, file, self.threads, folder)
        self.info = file.info
        self.identity = identity(file.info.file_sha256, engine)
        self.outputs = _checked_signature(self._session, file.path, file.info)

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
        world_from_cam (V, 4, 4) float32 relative to camera 0; near_far (2,) float32, z-depths; patch_mask (V, P) bool,
        False leaves a patch out. Returns means (N, 3), scales (N, 3), rotations_wxyz (N, 4), opacities (N,), harmonics
        (N, K, 3), depth and confidence (V, H, W), and where the network has them expert_index (V, P, k) int64,
        expert_weight (V, P, k), task_weight (V, P, 4) and route_margin (V, P). The first V * H * W Gaussians belong to
        the pixels, view by view, row by row; others may follow. Deterministic for a given input, thread count and
        engine. Raises `ModelError` for other shapes or types and for outputs that are not finite or out of range.
        """
        info, views = self.info, len(images)
        values: tuple[NDArray, ...] = (images, intrinsics, world_from_cam, near_far, patch_mask)
        feed = dict(zip(INPUTS, values, strict=True))
        for name, shape in _input_shapes(info, views).items():
            value, dtype = feed[name], np.dtype(np.bool_ if name == "patch_mask" else np.float32)
            if value.dtype != dtype or value.shape != shape:
                raise ModelError(f"is {value.dtype} {value.shape}, the model needs {dtype} {shape}", field=name)
        try:
            found = self._session.run(self.outputs, feed)
        except self._session.failures as error:
            cure = MORE_MEMORY if any(word in str(error) for word in _OUT_OF_MEMORY) else None
            raise ModelError(
                f"{self.made_by.name} failed on {views} views: {error}", field="model", cure=cure
            ) from error
        outputs = dict(zip(self.outputs, found, strict=True))
        _check_outputs(outputs, views, info)
        return outputs


def _input_shapes(info: ModelInfo, views: int | None) -> dict[str, Sides]:
    """Input shapes of the contract by name; None where `views` is None, which leaves the number open."""
    return {
        "images": (views, 3, info.height, info.width),
        "intrinsics": (views, 3, 3),
        "world_from_cam": (views, 4, 4),
        "near_far": (2,),
        "patch_mask": (views, info.patches),
    }


def _checked_signature(session: Session, path: Path, info: ModelInfo) -> tuple[str, ...]:
    """The names of the contract's outputs that this file has; it may have others besides.

    Raises `ModelError` for missing inputs or outputs, and for an input whose shape contradicts the metadata.
    """
    if set(session.inputs) != set(INPUTS):
        raise ModelError(f"{path} has the inputs {sorted(session.inputs)}, need {sorted(INPUTS)}", field="model")
    for name, need in _input_shapes(info, None).items():
        if not _fits(taken := session.inputs[name], need):
            raise ModelError(
                f"{path} takes {name} of {_shown(taken)}, its metadata gapmes.height {info.height} and gapmes.width "
                f"{info.width} mean {_shown(need)}",
                field="model",
                cure="export it again with gapmes-export",
            )
    missing = [name for name in REQUIRED_OUTPUTS if name not in session.outputs]
    if missing:
        raise ModelError(f"{path} lacks the outputs {', '.join(missing)}", field="model")
    return REQUIRED_OUTPUTS + tuple(name for name in OPTIONAL_OUTPUTS if name in session.outputs)


def _fits(taken: Sides, need: Sides) -> bool:
    """Whether two shapes are compatible: equal on every side that neither leaves open."""
    return len(taken) == len(need) and all(None in pair or pair[0] == pair[1] for pair in zip(taken, need, strict=True))


def _shown(sides: Sides) -> str:
    return f"({', '.join('any' if side is None else str(side) for side in sides)})"


def _check_outputs(outputs: Arrays, views: int, info: ModelInfo) -> None:
    """Check types and shapes, then finiteness and ranges; the `ModelError` names output, count and first index."""
    for name, value in outputs.items():
        dtype = np.dtype(np.int64 if name == "expert_index" else np.float32)
        found = getattr(value, "dtype", type(value).__name__)  # a sequence of tensors has none
        if found != dtype:
            raise ModelError(f"output is {found}, need {dtype}", field=name)
    (count,) = outputs["means"].shape[:1] or (0,)
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
    _require(outputs["depth"] > 0, "depth", "above 0")
    _require((outputs["opacities"] >= 0) & (outputs["opacities"] <= 1), "opacities", "in [0, 1]")
    for name in ("expert_weight", "task_weight"):
        if name in outputs:
            _require((outputs[name] >= 0) & (outputs[name] <= 1 + BF16), name, "in [0, 1]")
    if "expert_index" in outputs:
        index, experts = outputs["expert_index"], info.most_experts
        _require((index >= 0) & (index < experts), "expert_index", f"from 0 to {experts - 1}")


def _require(ok: NDArray[np.bool_], name: str, need: str) -> None:
    if not ok.all():
        first = [int(i) for i in np.argwhere(~ok)[0]]
        raise ModelError(f"{int((~ok).sum())} of {ok.size} numbers are not {need}, first at {first}", field=name)
