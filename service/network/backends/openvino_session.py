"""The network in OpenVINO, an optional package: the same file, in a precision that is always said."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from typing import Any, Literal

from numpy.typing import NDArray

from ...cameras.view_checks import MIN_VIEWS
from ...errors import ModelError
from ..model_file import ModelFile
from .choice import Sides

Precision = Literal["fp32", "bf16"]

KEPT = 2  # networks compiled for a number of views: a scene needs two, its own and that of those who foretell one
PER_VIEW = ("images", "intrinsics", "world_from_cam", "patch_mask")  # inputs whose first side is the number of views


class OpenVinoSession:
    """A network of OpenVINO on the CPU, see `Session`; compiled per number of views, which halves a run's time."""

    failures: tuple[type[Exception], ...] = (RuntimeError,)

    def __init__(self, file: ModelFile, threads: int, precision: Precision) -> None:
        """Load `file` and compile it for the fewest views. Raises `ModelError` where processor or package cannot do
        it."""
        import openvino

        self._path, self._threads, self._precision = file.path, threads, precision
        self._lock = threading.Lock()
        self._compiled: OrderedDict[int, Any] = OrderedDict()
        try:
            self._core = openvino.Core()
            self._model = self._core.read_model(str(file.path))
            self.inputs: Mapping[str, Sides] = {
                port.get_any_name(): _sides(port.get_partial_shape()) for port in self._model.inputs
            }
            self.outputs: Sequence[str] = [port.get_any_name() for port in self._model.outputs]
            if set(PER_VIEW) <= set(self.inputs):
                self._for(MIN_VIEWS)
        except RuntimeError as error:
            raise ModelError(f"{file.path} cannot be loaded by openvino: {error}", field="model") from error

    def run(self, names: Sequence[str], feed: dict[str, NDArray]) -> list[Any]:
        """The outputs of these names; a request of its own for each call, so that threads share nothing."""
        found = self._for(len(feed["images"])).create_infer_request().infer(feed)
        return [found[name] for name in names]

    def _for(self, views: int) -> Any:
        """The network compiled for this number of views; those that were used longest ago are dropped."""
        with self._lock:
            if views not in self._compiled:
                model = self._model.clone()
                shapes = {port.get_any_name(): port.get_partial_shape() for port in model.inputs}
                model.reshape({name: [views, *list(shapes[name])[1:]] for name in PER_VIEW})
                self._compiled[views] = self._checked(self._core.compile_model(model, "CPU", self._properties()))
            self._compiled.move_to_end(views)
            while len(self._compiled) > KEPT:
                self._compiled.popitem(last=False)
            return self._compiled[views]

    def _properties(self) -> dict[str, Any]:
        """Nothing that changes numbers or load is left to the package: where a processor has bf16, its default is that,
        and it would bind threads to the same first cores in every process."""
        return {
            "INFERENCE_PRECISION_HINT": _NATIVE[self._precision],
            "INFERENCE_NUM_THREADS": self._threads,
            "NUM_STREAMS": 1,
            "ENABLE_CPU_PINNING": False,
        }

    def _checked(self, compiled: Any) -> Any:
        """Where a processor cannot do a precision, OpenVINO takes another one without a word."""
        taken = str(compiled.get_property("INFERENCE_PRECISION_HINT").get_type_name())
        if taken != _NATIVE[self._precision]:
            raise ModelError(
                f"OpenVINO computes in {taken} on this processor, asked for was {_NATIVE[self._precision]}",
                field="engine",
                cure="take the engine openvino-fp32 or onnxruntime",
            )
        return compiled


def _sides(shape: Any) -> Sides:
    """Of a PartialShape."""
    return tuple(side.get_length() if side.is_static else None for side in shape)


_NATIVE: dict[str, str] = {"fp32": "f32", "bf16": "bf16"}
