"""Does everything that a reconstruction needs work on this machine, and how fast: one finding after the other."""

from __future__ import annotations

import os
import platform
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Literal

import numpy as np

from .process.control_group import cpu_limit, memory_limit_mb
from .process.machine import available_memory_mb, processor
from .process.threads import available_threads
from .scenes.own_files import check_own_files
from .settings import Settings
from .shipped import sample_folder

if TYPE_CHECKING:
    from .network.engine import Engine
    from .network.model_info import ModelInfo

State = Literal["ok", "warning", "failure"]

PACKAGES = ("gapmes", "numpy", "numba", "onnxruntime", "pillow", "fastapi")
EXTRAS = {"openvino": "openvino", "video": "av", "export": "torch"}  # and the package that each is for
BF16_FLAGS = ("avx512_bf16", "amx_bf16", "bf16")
LEAST_MEMORY_MB = 1000.0  # a process takes about a third of it for two views
LEAST_DISK_MB = 500.0  # some fifty scenes of two views
LEAST_PSNR_DB = 25.0  # of a picture of the sample; the shipped network has 28.1


@dataclass(frozen=True)
class Finding:
    """What was looked at, and how it is."""

    name: str
    state: State
    text: str


class Doctor:
    """Looks at one thing after the other; what fails keeps nobody from looking at the rest."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._engine: Engine | None = None

    @property
    def looks(self) -> dict[str, Callable[[], tuple[State, str]]]:
        """By their names in their order; the last one takes the sample from photographs to a picture."""
        further = {"models": self._models} if self._settings.models else {}
        return {
            "versions": self._versions,
            "extras": self._extras,
            "processor": self._processor,
            "threads": self._threads,
            "memory": self._memory,
            "model": self._model,
            **further,
            "kernels": self._kernels,
            "store": self._store,
            "caches": self._caches,
            "sample": self._sample,
        }

    def findings(self) -> Iterator[Finding]:
        """What each of `looks` finds."""
        for name, look in self.looks.items():
            try:
                yield Finding(name, *look())
            except Exception as error:
                yield Finding(name, "failure", f"{type(error).__name__}: {error}")

    def _versions(self) -> tuple[State, str]:
        found = [f"{name} {version(name)}" for name in PACKAGES]
        return "ok", ", ".join([*found, f"Python {platform.python_version()}"])

    def _extras(self) -> tuple[State, str]:
        return "ok", ", ".join(f"{extra}: {_installed(package)}" for extra, package in EXTRAS.items())

    def _processor(self) -> tuple[State, str]:
        name, flags = processor()
        slow = platform.machine() == "x86_64" and "avx2" not in flags
        listed = ", ".join(flags) or "none of the instruction sets that make it quick"
        return ("warning" if slow else "ok"), f"{name}: {listed}"

    def _threads(self) -> tuple[State, str]:
        limit = cpu_limit()
        granted = "no limit" if limit is None else f"a limit of {limit:g} CPUs"
        return "ok", f"{self._settings.threads or available_threads()} of {os.cpu_count()} cores, {granted}"

    def _memory(self) -> tuple[State, str]:
        free, limit = available_memory_mb(), memory_limit_mb()
        if free is None:
            return "ok", "this system does not say how much is free"
        granted = "no limit" if limit is None else f"a limit of {limit:.0f} MB"
        state: State = "ok" if min(free, limit or free) >= LEAST_MEMORY_MB else "warning"
        return state, f"{free:.0f} MB free, {granted}, {LEAST_MEMORY_MB:.0f} are enough"

    def _model(self) -> tuple[State, str]:
        from .network.engine import Engine

        start = time.perf_counter()
        self._engine = Engine(self._settings.model, threads=self._settings.threads, engine=self._settings.engine)
        seconds, made_by = time.perf_counter() - start, self._engine.made_by
        text = f"{_described(self._engine.info)}, loaded by {made_by.name} in {seconds:.1f} s"
        if made_by.precision == "bf16" and not set(BF16_FLAGS) & set(processor()[1]):
            return "warning", f"{text}; bf16 is slow here: the processor has no instructions for it, take openvino-fp32"
        return "ok", f"{text}, computed in {made_by.precision}"

    def _models(self) -> tuple[State, str]:
        """Those that a request may name: looked at, their weights summed, not loaded."""
        from .models import Models

        models, parts = Models(self._settings), []
        for name in models.names:
            file = models.get(name).file
            if file.weights is not None:
                file.weights.check()
            parts.append(f"{name}: {_described(file.info)}, {file.bytes / 2**20:,.0f} MB")
        budget = self._settings.model_bytes
        limit = "no budget" if budget is None else f"a budget of {budget / 2**20:,.0f} MB"
        return "ok", f"{'; '.join(parts)}; {limit}"

    def _kernels(self) -> tuple[State, str]:
        from .kernels import warm_up
        from .splat.kernel_cache import KERNELS, not_kept

        there = any(KERNELS.rglob("*.nbi"))
        start = time.perf_counter()
        warm_up()
        seconds = time.perf_counter() - start
        text = f"{'loaded' if there else 'compiled'} in {seconds:.1f} s"
        why = not_kept()
        return ("ok", f"{text}, kept in {KERNELS}") if why is None else ("warning", f"{text}; {why}")

    def _store(self) -> tuple[State, str]:
        folder = self._settings.store
        nearest = next(path for path in (folder, *folder.parents) if path.exists())
        free = shutil.disk_usage(nearest).free / 2**20
        text = f"{folder}, {free:,.0f} MB free"
        try:
            check_own_files(folder)
            with TemporaryDirectory(prefix=".gapmes-", dir=nearest):
                pass
        except OSError as error:
            inside = f"{error.filename} " if error.filename and Path(error.filename).exists() else ""
            return "failure", f"{text}, {inside}cannot be written: {error.strerror}"
        there = "" if nearest == folder else ", will be made"
        return ("ok" if free >= LEAST_DISK_MB else "warning"), text + there

    def _caches(self) -> tuple[State, str]:
        """Both are made anew where they are missing."""
        from .http.runtime import MODELS
        from .splat.kernel_cache import ELSEWHERE, KERNELS

        folders = {"kernels": KERNELS, "optimised models": self._settings.store / MODELS}
        text = ", ".join(f"{name}: {folder} {_size(folder)}" for name, folder in folders.items())
        return ("ok", text) if ELSEWHERE is None else ("warning", f"{text}; {ELSEWHERE}")

    def _sample(self) -> tuple[State, str]:
        """Two photographs to a scene, and its picture beside a third."""
        from .captures.capture import load_scene_folder
        from .photographs.images import decode_image, fit_view
        from .pictures.picture_error import psnr
        from .reconstruct import Reconstructor

        if self._engine is None:
            return "failure", "there is no model"
        folder = load_scene_folder(sample_folder(), lambda _: (1, 5, 3))
        photos = [decode_image(path.read_bytes(), index=i) for i, path in enumerate(folder.image_paths)]
        start = time.perf_counter()
        scene = Reconstructor(self._engine).reconstruct(
            photos[:2], folder.file.cameras[:2], near=folder.file.near, far=folder.file.far
        )
        middle = time.perf_counter()
        held_back = fit_view(photos[2], folder.file.cameras[2], self._engine.info.height, self._engine.info.width)
        picture = scene.render(held_back.camera, outputs=(), threads=self._settings.threads)
        seconds = time.perf_counter() - middle
        score = psnr(np.clip(picture.rgb, 0, 1).transpose(2, 0, 1), held_back.image)
        times = f"a scene in {middle - start:.1f} s, a picture in {1000 * seconds:.0f} ms"
        return ("ok" if score >= LEAST_PSNR_DB else "failure"), f"{times}, {score:.1f} dB beside the photograph"


def _described(info: ModelInfo) -> str:
    return f"{info.preset}, {info.width} x {info.height} px, {info.precision}, weights {info.weights_sha256[:12]}"


def _installed(package: str) -> str:
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError:
        return "not installed"


def _size(folder: Path) -> str:
    if not folder.is_dir():
        return "(not there yet)"
    return f"({sum(path.stat().st_size for path in folder.rglob('*') if path.is_file()) / 2**20:,.1f} MB)"


def verdict(findings: list[Finding]) -> str:
    """One line for all of them."""
    failed = [finding.name for finding in findings if finding.state == "failure"]
    doubtful = [finding.name for finding in findings if finding.state == "warning"]
    if failed:
        return f"does not work here: {', '.join(failed)}"
    return "works here" if not doubtful else f"works here, but look at: {', '.join(doubtful)}"
