"""Depth-Anything-V2's published layouts, transformers' and the original, into `DepthAnything`."""

from __future__ import annotations

import re
from pathlib import Path

from torch import Tensor

from ..backbones import DepthAnythingFeatures
from ..depth_anything import DepthAnything
from ..weights_file import CheckpointError
from .config_file import compare, read_config, stated_of_depth, stated_of_tapped_vit, vit_section
from .dinov2 import OPTIONAL, refuse_variants, vit_parts, with_source
from .files import TensorFile, read_tensors
from .fit import Fit, LeftOut, Part, fit
from .recognise import ORIGINAL, VitFile, find_vit
from .sources import resolve

# Fusion goes from the coarsest level to the finest, and the coarsest has nothing to add to: this unit is never run.
_NEVER_RUN = "neck.fusion_stage.layers.0.residual_layer1."

_ORIGINAL: tuple[tuple[re.Pattern[str], str], ...] = tuple(
    (re.compile(pattern), target)
    for pattern, target in (
        (r"projects\.([0-3])\.(weight|bias)", r"neck.reassemble_stage.layers.\1.projection.\2"),
        (r"resize_layers\.([013])\.(weight|bias)", r"neck.reassemble_stage.layers.\1.resize.\2"),
        (r"scratch\.output_conv1\.(weight|bias)", r"head.conv1.\1"),
        (r"scratch\.output_conv2\.0\.(weight|bias)", r"head.conv2.\1"),
        (r"scratch\.output_conv2\.2\.(weight|bias)", r"head.conv3.\1"),
    )
)
_LEVEL = re.compile(r"scratch\.layer([1-4])_rn\.weight")
_REFINE = re.compile(r"scratch\.refinenet([1-4])\.(.+)\.(weight|bias)")
_IN_REFINE = {
    "out_conv": "projection",
    **{f"resConfUnit{u}.conv{c}": f"residual_layer{u}.convolution{c}" for u in (1, 2) for c in (1, 2)},
}


def load_depth_anything(features: DepthAnythingFeatures, source: str | Path) -> Fit:
    """Load Depth-Anything-V2 whole, encoder and head, strictly, and report on every tensor.

    `source` is a file, a folder or a hub name (see `resolve`). A `config.json` beside the weights is checked too: the
    first Depth-Anything and the metric models of the second have the same tensors and compute something else, which a
    bare `.pth` does not tell. Raises `CheckpointError`, and then `features` is unchanged.
    """
    found = resolve(source)
    report, tensors = fit_depth_anything(read_tensors(found.path), features.model)
    if found.config is not None:
        document, model = read_config(found.config), features.model
        cure = "take the relative model of the second version, for example depth-anything/Depth-Anything-V2-Small-hf"
        compare(found.config, document, stated_of_depth(model.config), cure)
        compare(found.config, vit_section(document), stated_of_tapped_vit(model.config, model.shape), cure)
    features.model.load_state_dict(tensors, strict=True)
    return with_source(report, found)


def fit_depth_anything(file: TensorFile, model: DepthAnything) -> tuple[Fit, dict[str, Tensor]]:
    """The report and the state dict for `model`.

    Raises `CheckpointError`: see `fit`; also for an encoder without a head.
    """
    held = find_vit(file.path, file.tensors)
    refuse_variants(file.path, held)
    if not held.depth_head:
        raise CheckpointError(
            f"{file.path} is {held.name} without a depth head; take Depth-Anything-V2 whole, for example "
            f"depth-anything/Depth-Anything-V2-Small-hf or depth_anything_v2_vits.pth"
        )

    def names(source: str) -> tuple[Part, ...] | LeftOut | None:
        if source.startswith(held.prefix):
            parts = vit_parts(held, source)
            return None if parts is None else tuple(Part(f"backbone.{p.target}", p.index, p.of) for p in parts)
        return head_parts(held, source) if source.startswith(held.root) else None

    expected = model.state_dict()
    optional = {f"backbone.{name}": reason for name, reason in OPTIONAL.items()}
    optional |= {name: "not in the file; never run" for name in expected if name.startswith(_NEVER_RUN)}
    recognised = held.recognised(model.config)
    return fit(file, expected, names, recognised=recognised, optional=optional)


def head_parts(held: VitFile, source: str) -> tuple[Part, ...] | None:
    """The tensor of neck or head that one of the file's gives; None when that layout has no such name."""
    name = source.removeprefix(held.root)
    if held.layout != ORIGINAL:
        return (Part(name),) if name.startswith(("neck.", "head.")) else None
    if not name.startswith("depth_head."):
        return None
    name = name.removeprefix("depth_head.")
    if match := _LEVEL.fullmatch(name):
        return (Part(f"neck.convs.{int(match[1]) - 1}.weight"),)
    if (match := _REFINE.fullmatch(name)) and match[2] in _IN_REFINE:
        # Numbered from the finest level there, in the order in which they run here.
        return (Part(f"neck.fusion_stage.layers.{4 - int(match[1])}.{_IN_REFINE[match[2]]}.{match[3]}"),)
    for pattern, target in _ORIGINAL:
        if match := pattern.fullmatch(name):
            return (Part(match.expand(target)),)
    return None
