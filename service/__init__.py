"""gapmes.service: cameras, Gaussians, .ply, CPU splatter, onnxruntime engine and HTTP service. Loads no torch."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .budget import Budget as Budget
    from .camera import Camera as Camera
    from .errors import GapmesError as GapmesError
    from .errors import InputError as InputError
    from .formats.registry import read_gaussians as read_gaussians
    from .formats.registry import write_gaussians as write_gaussians
    from .gaussians import Gaussians as Gaussians
    from .images import EncodedPhoto as EncodedPhoto
    from .images import Photo as Photo
    from .ply import inspect_ply as inspect_ply
    from .ply import read_ply as read_ply
    from .ply import write_ply as write_ply
    from .reconstruct import Reconstructor as Reconstructor
    from .reconstruct import Scene as Scene
    from .splat import Render as Render
    from .splat import render as render
    from .splat import render_reference as render_reference

_HOME = {
    "Budget": "budget",
    "Camera": "camera",
    "EncodedPhoto": "images",
    "GapmesError": "errors",
    "Gaussians": "gaussians",
    "InputError": "errors",
    "Photo": "images",
    "Reconstructor": "reconstruct",
    "Render": "splat",
    "Scene": "reconstruct",
    "inspect_ply": "ply",
    "read_gaussians": "formats.registry",
    "read_ply": "ply",
    "render": "splat",
    "render_reference": "splat",
    "write_gaussians": "formats.registry",
    "write_ply": "ply",
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
