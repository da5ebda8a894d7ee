"""Which runtime computes the network and in which precision: names, what results say of it, and opening a session."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal, Protocol, get_args

from numpy.typing import NDArray

from ...arguments import shown
from ...errors import ModelError
from ..model_file import ModelFile

EngineName = Literal["onnxruntime", "openvino-fp32", "openvino-bf16"]
ENGINES: tuple[EngineName, ...] = get_args(EngineName)
DEFAULT_ENGINE: EngineName = "onnxruntime"
Sides = tuple[int | None, ...]  # of an input; None where the graph takes any


@dataclass(frozen=True)
class MadeBy:
    """What computed a result: as the scene document and `GET /models` tell it."""

    name: str
    version: str
    precision: str  # of what is computed in floating point; that of the weights is the model's own

    def document(self) -> dict[str, str]:
        """Plain JSON."""
        return asdict(self)


class Session(Protocol):
    """A loaded network; `run` may be called from several threads at once."""

    inputs: Mapping[str, Sides]
    outputs: Sequence[str]
    failures: tuple[type[Exception], ...]  # what `run` raises where the runtime fails

    def run(self, names: Sequence[str], feed: dict[str, NDArray]) -> list[Any]:
        """The outputs of these names."""
        ...


def checked_engine(name: object) -> EngineName:
    """The name of an engine. Raises `ModelError` for anything else, also for what is no text."""
    for known in ENGINES:
        if name == known:
            return known
    raise ModelError(f"{shown(name)} is no engine", field="engine", cure=f"one of {', '.join(ENGINES)}")


def made_by(engine: EngineName) -> MadeBy:
    """What an engine's results will say. Raises `ModelError` where its package is missing."""
    package, _, precision = engine.partition("-")
    if package == "onnxruntime":  # which several distributions bring, each under a name of its own
        import onnxruntime

        return MadeBy(package, onnxruntime.__version__, "fp32")
    try:
        return MadeBy(package, version(package), precision)
    except PackageNotFoundError as error:
        raise ModelError(
            f"the engine {engine} needs the package {package}, which is not installed",
            field="engine",
            cure=f"pip install 'gapmes[{package}]', or take the engine {DEFAULT_ENGINE}",
        ) from error


def open_session(engine: EngineName, file: ModelFile, threads: int, prepare: Path | None) -> Session:
    """Load `file` for `threads` threads; `prepare` as for `Engine`. Raises `ModelError`."""
    if engine == "onnxruntime":
        from .onnxruntime_session import OnnxRuntimeSession

        return OnnxRuntimeSession(file, threads, prepare)
    from .openvino_session import OpenVinoSession

    return OpenVinoSession(file, threads, "bf16" if engine == "openvino-bf16" else "fp32")


def identity(file_sha256: str, engine: EngineName) -> str:
    """What results depend on beside the inputs: the model's file, and the engine where it is not the default one."""
    return file_sha256 if engine == DEFAULT_ENGINE else f"{file_sha256} {engine}"
