"""A cache of models as optimised by onnxruntime for this processor, with external weights that all processes map.

They load faster, and their weights are in memory once for any number of processes: a session of the packaged network
needs 17 MB less of its own.
"""

from __future__ import annotations

import hashlib
import logging
import os
import platform
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..process.disk import sync
from ..process.file_lock import exclusive

MODEL, WEIGHTS, DIGEST = "model.onnx", "model.weights", "sha256"
INCOMING = ".incoming-"
LEAST_BYTES = "1024"  # smaller tensors stay in the graph
KEPT_S = 30 * 86_400.0  # an entry that nobody has used for so long goes when another one is made
_KEY_LENGTH = 32  # hexadecimal digits

_log = logging.getLogger("gapmes")


def prepared(path: Path, file_sha256: str, folder: Path, options: Callable[[], Any]) -> Path | None:
    """The path of the optimised model in `folder`, which is made if it is missing; None where it cannot be made.

    `options` makes the session options. Entries are keyed by the model's sha256, the version of onnxruntime and the
    processor, so that none of another kind is used.
    """
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
                _remove_unused(folder)
                _make(path, target, options())
            os.utime(target)
    except Exception as error:  # a full or read-only disk, or a graph that cannot be written: it is only a shortcut
        _log.warning("the model is loaded as it is: %s", error)
        return None
    return target / MODEL


def _remove_unused(folder: Path) -> None:
    """Remove the entries of older files, versions and processors; a process that still maps one keeps it."""
    for entry in folder.glob("?" * _KEY_LENGTH):
        ours = all((entry / name).is_file() for name in (MODEL, DIGEST))  # the folder may hold other things
        if ours and time.time() - entry.stat().st_mtime > KEPT_S:
            shutil.rmtree(entry, ignore_errors=True)


def forget(optimised: Path) -> None:
    """Remove an optimised model that turned out to be damaged."""
    _log.warning("the optimised model is damaged, and will be made again")
    shutil.rmtree(optimised.parent, ignore_errors=True)


def _make(path: Path, target: Path, options: Any) -> None:
    """Write the optimised model of `path` as the folder `target`, atomically."""
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
    """Whether all files exist and have the recorded sha256."""
    return all((folder / name).is_file() for name in (MODEL, WEIGHTS, DIGEST)) and _digest(folder) == (
        folder / DIGEST
    ).read_text(errors="replace")


def _digest(folder: Path) -> str:
    """The sha256 of graph and weights: after a power failure a file may have the right size and wrong content."""
    digest = hashlib.sha256()
    for name in (MODEL, WEIGHTS):
        with (folder / name).open("rb") as file:
            hashlib.file_digest(file, lambda: digest)
    return digest.hexdigest()


def _key(file_sha256: str, runtime: str) -> str:
    """The cache key: onnxruntime chooses kernels by the processor's instruction sets."""
    flags = ""
    info = Path("/proc/cpuinfo")
    if info.is_file():
        lines = info.read_text(encoding="ascii", errors="replace").splitlines()
        flags = next((line for line in lines if line.startswith(("flags", "Features"))), "")
    text = "\n".join((file_sha256, runtime, platform.machine(), flags))
    return hashlib.sha256(text.encode()).hexdigest()[:_KEY_LENGTH]
