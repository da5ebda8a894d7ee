"""The `gapmes.*` metadata of an exported file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING

import onnx

from gapmes.model.config import PIXELS_PER_PATCH
from gapmes.service.cameras.view_checks import MAX_VIEWS, MIN_VIEWS
from gapmes.service.network.contract import FORMAT

if TYPE_CHECKING:
    from gapmes.model.architectures import Network

OPSET = 20  # the newest that all backends in the documentation support
NEAR_FAR_RULE = "z-depth range in the units of the poses; candidates are uniform in 1/z from 1/far to 1/near"


def contract_metadata(
    network: Network, *, height: int, width: int, weights_sha256: str, licence: str, precision: str
) -> dict[str, str]:
    """All metadata but the tolerance, which verification adds; keys without the prefix."""
    return {
        "format": FORMAT,
        "preset": network.config.preset,
        "config": network.config.to_json(),
        "weights_sha256": weights_sha256,
        "opset": str(OPSET),
        "height": str(height),
        "width": str(width),
        "size_rule": "fixed height and width",
        "views": json.dumps([MIN_VIEWS, MAX_VIEWS]),
        "patch_px": str(PIXELS_PER_PATCH),
        "near_far": NEAR_FAR_RULE,
        "licence": licence,
        "precision": precision,
    }


def add_metadata(model: onnx.ModelProto, values: Mapping[str, str]) -> None:
    """Set `gapmes.*` metadata in place, sorted; existing ones stay unless replaced, other keys are removed."""
    kept = {p.key: p.value for p in model.metadata_props if p.key.startswith("gapmes.")}
    kept.update({f"gapmes.{key}": value for key, value in values.items()})
    del model.metadata_props[:]
    for key in sorted(kept):
        model.metadata_props.add(key=key, value=kept[key])
