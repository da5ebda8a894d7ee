"""gapmes.service: cameras, Gaussians, .ply, CPU splatter, onnxruntime engine and HTTP service. Loads no torch."""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING

os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")  # onnxruntime reads it when it is first imported, wherever that is

if TYPE_CHECKING:
    from .cameras.camera import Camera as Camera
    from .errors import GapmesError as GapmesError
    from .errors import InputError as InputError
    from .formats.ply import inspect_ply as inspect_ply
    from .formats.ply import read_ply as read_ply
    from .formats.ply import write_ply as write_ply
    from .formats.registry import read_gaussians as read_gaussians
    from .formats.registry import write_gaussians as write_gaussians
    from .from_capture import reconstruct_capture as reconstruct_capture
    from .gaussians import Gaussians as Gaussians
    from .leaving_out.budget import Budget as Budget
    from .photographs.images import EncodedPhoto as EncodedPhoto
    from .photographs.images import Photo as Photo
    from .reconstruct import Reconstructor as Reconstructor
    from .reconstruct import Scene as Scene
    from .splat import Render as Render
    from .splat import render as render
    from .splat import render_reference as render_reference

_HOME = {
    "Budget": "leaving_out.budget",
    "Camera": "cameras.camera",
    "EncodedPhoto": "photographs.images",
    "GapmesError": "errors",
    "Gaussians": "gaussians",
    "InputError": "errors",
    "Photo": "photographs.images",
    "Reconstructor": "reconstruct",
    "Render": "splat",
    "Scene": "reconstruct",
    "inspect_ply": "formats.ply",
    "read_gaussians": "formats.registry",
    "read_ply": "formats.ply",
    "reconstruct_capture": "from_capture",
    "render": "splat",
    "render_reference": "splat",
    "write_gaussians": "formats.registry",
    "write_ply": "formats.ply",
}

__all__ = [
    "Budget",
    "Camera",
    "EncodedPhoto",
    "GapmesError",
    "Gaussians",
    "InputError",
    "Photo",
    "Reconstructor",
    "Render",
    "Scene",
    "inspect_ply",
    "read_gaussians",
    "read_ply",
    "reconstruct_capture",
    "render",
    "render_reference",
    "write_gaussians",
    "write_ply",
]


def __getattr__(name: str) -> object:
    """Load public names on first use, so that importing the package loads neither numba nor onnxruntime."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_HOME[name]}", __name__), name)


def __dir__() -> list[str]:
    """With the public names that no one has used yet, which a notebook completes."""
    return sorted({*globals(), *__all__})
