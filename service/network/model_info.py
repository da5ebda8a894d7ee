"""The `gapmes.*` ONNX metadata of an exported model, parsed and checked."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..arguments import shown
from ..errors import ModelError
from .contract import FORMAT

PATCH_PX = 16
MOST_EXPERTS = 128
_COUNTS = {"experts": (1, MOST_EXPERTS), "depth_planes": (2, 4096)}  # of the configuration: least and most
_REQUIRED = ("preset", "config", "weights_sha256", "opset", "height", "width", "patch_px", "licence", "precision")


@dataclass(frozen=True)
class ModelInfo:
    """The metadata of an exported model, and the sha256 of its file."""

    preset: str
    config: dict[str, Any]
    weights_sha256: str
    file_sha256: str
    height: int  # px, of every view
    width: int  # px
    patch: int  # px
    opset: int
    licence: str
    precision: str  # fp32, int8, ...
    tolerance: dict[str, Any]  # measured at export, per output
    keep_all: bool = False  # every expert runs on every patch, every pair of views is compared

    @property
    def depth_planes(self) -> int | None:
        """Number of planes of the network's plane sweep; None where the configuration does not state it."""
        return self.config.get("depth_planes")

    @property
    def experts(self) -> int | None:
        """Number of experts; None where the configuration does not state it."""
        return self.config.get("experts")

    @property
    def most_experts(self) -> int:
        """An upper limit of their number."""
        return MOST_EXPERTS if self.experts is None else self.experts

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of a view, px."""
        return self.height, self.width

    @property
    def patch_shape(self) -> tuple[int, int]:
        """Rows and columns of the patches of a view."""
        return self.height // self.patch, self.width // self.patch

    @property
    def patches(self) -> int:
        """Patches of one view."""
        rows, columns = self.patch_shape
        return rows * columns

    def document(self) -> dict[str, Any]:
        """What the service and its scenes tell of a model, as JSON values."""
        names = ("preset", "weights_sha256", "file_sha256", "precision", "licence", "height", "width")
        return {name: getattr(self, name) for name in names}


def parse_model_info(metadata: Mapping[str, str], path: Path, file_sha256: str) -> ModelInfo:
    """Parse the ONNX `metadata` of the model at `path`. Raises `ModelError` for one that is no gapmes model, of another
    format, incomplete or malformed."""
    if "gapmes.format" not in metadata:
        raise ModelError(f"{path} is an ONNX file, but not a gapmes model: it has no gapmes.format", field="model")
    if metadata["gapmes.format"] != FORMAT:
        raise ModelError(
            f"{path} has format {metadata['gapmes.format']}, this version reads {FORMAT}",
            field="model",
            cure="export it again with this version's gapmes-export",
        )
    missing = [name for name in _REQUIRED if f"gapmes.{name}" not in metadata]
    if missing:
        raise ModelError(f"{path} lacks the metadata {', '.join('gapmes.' + name for name in missing)}", field="model")
    value = {name: metadata[f"gapmes.{name}"] for name in _REQUIRED}
    try:
        info = ModelInfo(
            preset=value["preset"],
            config=_checked_counts(_object("config", value["config"])),
            weights_sha256=value["weights_sha256"],
            file_sha256=file_sha256,
            height=int(value["height"]),
            width=int(value["width"]),
            patch=int(value["patch_px"]),
            opset=int(value["opset"]),
            licence=value["licence"],
            precision=value["precision"],
            tolerance=_object("tolerance", metadata.get("gapmes.tolerance", "{}")),
            keep_all=metadata.get("gapmes.keep_all") == "true",
        )
    except ValueError as error:
        raise ModelError(f"{path} has malformed metadata: {error}", field="model") from error
    sides = (info.height, info.width)
    if info.patch != PATCH_PX or min(sides) < PATCH_PX or any(side % PATCH_PX for side in sides):
        raise ModelError(
            f"{path} is for {info.width} x {info.height} px in patches of {info.patch}, need multiples of {PATCH_PX}",
            field="model",
        )
    return info


def _checked_counts(config: dict[str, Any]) -> dict[str, Any]:
    """The configuration itself. Raises `ValueError` for counts that no network has."""
    for name, (least, most) in _COUNTS.items():
        if name in config and not (type(found := config[name]) is int and least <= found <= most):
            need = f"need a whole number from {least} to {most}"
            raise ValueError(f"gapmes.config has {name} {shown(found)}, {need}")
    return config


def _object(name: str, text: str) -> dict[str, Any]:
    """Parse a JSON object. Raises `ValueError` for any other text."""
    try:
        found = json.loads(text)
    except RecursionError:
        raise ValueError(f"gapmes.{name} is nested too deeply") from None
    except ValueError as error:
        raise ValueError(f"gapmes.{name} is no JSON: {error}") from error
    if not isinstance(found, dict):
        raise ValueError(f"gapmes.{name} is {text[:50]!r}, need a JSON object")
    return found
