"""A model as onnxruntime has optimised it for this processor, weights in a file beside it that all processes map.

Loading it takes less time, and the weights are in memory once however many processes use them: a session of the
packaged network has 17 MB less of its own.
"""

from __future__ import annotations

import hashlib
import logging
import platform
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..process.disk import sync
from ..process.file_lock import exclusive

MODEL, WEIGHTS, DIGEST = "model.onnx", "model.weights", "sha256"
INCOMING = ".incoming-"
LEAST_BYTES = "1024"  # of a table that goes into the file beside the graph

_log = logging.getLogger("gapmes")


def prepared(path: Path, file_sha256: str, folder: Path, options: Callable[[], Any]) -> Path | None:
    """The optimised file in `folder`, made if it is not there; None where it cannot be made. `options` makes those of a
    session; nothing in `folder` is used that another version, processor or model file has left."""
    import onnxruntime as ort

    target = folder / _key(file_sha256, ort.__version__)
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        with exclusive(folder / ".lock"):
            for leftover in folder.glob(f"{INCOMING}*"):
                shutil.rmtree(leftover, ignore_errors=True)
            if target.is_dir() and not _whole(target):
                forget(target / MODEL)
            if not (target / MODEL).is_file():
                _make(path, target, options())
    except Exception as error:  # a full or read-only disk, or a graph that cannot be written: it is only a shortcut
        _log.warning("the model is loaded as it is: %s", error)
        return None
    return target / MODEL


def forget(optimised: Path) -> None:
    """Remove a file that turned out to be damaged."""
    _log.warning("the optimised model is damaged, and will be made again")
    shutil.rmtree(optimised.parent, ignore_errors=True)


def _make(path: Path, target: Path, options: Any) -> None:
    import onnxruntime as ort

    incoming = Path(tempfile.mkdtemp(prefix=INCOMING, dir=target.parent))
    try:
        options.optimized_model_filepath = str(incoming / MODEL)
        entry = "session.optimized_model_external_initializers"
        options.add_session_config_entry(f"{entry}_file_name", WEIGHTS)
        options.add_session_config_entry(f"{entry}_min_size_in_bytes", LEAST_BYTES)
        options.add_session_config_entry("session.save_external_prepacked_constant_initializers", "1")
        ort.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        (incoming / DIGEST).write_text(_digest(incoming))
        for file in incoming.iterdir():
            file.chmod(0o600)
            sync(file)
        sync(incoming)
        incoming.rename(target)
    finally:
        shutil.rmtree(incoming, ignore_errors=True)


def _whole(folder: Path) -> bool:
    """Whether all parts are there, as they were made."""
    return all((folder / name).is_file() for name in (MODEL, WEIGHTS, DIGEST)) and _digest(folder) == (
        folder / DIGEST
    ).read_text(errors="replace")


def _digest(folder: Path) -> str:
    """Of graph and weights: a power cut may leave files of the right length."""
    digest = hashlib.sha256()
    for name in (MODEL, WEIGHTS):
        with (folder / name).open("rb") as file:
            hashlib.file_digest(file, lambda: digest)
    return digest.hexdigest()


def _key(file_sha256: str, runtime: str) -> str:
    """What the optimised graph depends on: kernels are chosen by the processor's instructions."""
    flags = ""
    info = Path("/proc/cpuinfo")
    if info.is_file():
        lines = info.read_text(encoding="ascii", errors="replace").splitlines()
        flags = next((line for line in lines if line.startswith(("flags", "Features"))), "")
    text = "\n".join((file_sha256, runtime, platform.machine(), flags))
    return hashlib.sha256(text.encode()).hexdigest()[:32]
