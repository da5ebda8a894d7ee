"""What ViT a file holds, told from its tensors' names and shapes: whose names, which size, and which preset that is."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from torch import Tensor

from ..config import PRESETS, VitConfig
from ..weights_file import CheckpointError, wrapper_of
from .fit import Recognised

ORIGINAL, TRANSFORMERS_4, TRANSFORMERS_5 = "original", "transformers 4", "transformers 5"

SIZES = {(384, 12): "ViT-S", (768, 12): "ViT-B", (1024, 24): "ViT-L", (1536, 40): "ViT-g"}

# Tensors before the first block, by which a ViT and what its names are prefixed with are found.
_ANCHORS_TRANSFORMERS = re.compile(
    r"^(?P<prefix>(?:.*\.)?)embeddings\.(?:cls_token|position_embeddings|patch_embeddings\.projection\.(?:weight|bias))$"
)
_ANCHORS_ORIGINAL = re.compile(r"^(?P<prefix>(?:.*\.)?)(?:cls_token|pos_embed|patch_embed\.proj\.(?:weight|bias))$")
# The original stores blocks in chunks where it was trained so; the number within a chunk counts from the first block.
_BLOCK = re.compile(r"^(?:encoder\.layer\.|blocks\.(?:\d+\.(?=\d))?)(?P<block>\d+)\.(?P<rest>.+)$")

# How tensor names begin: in DepthSplat (with its trainer or without), in its Gaussian head, in UniMatch; and in a
# depth-only DepthSplat, beside names of UniMatch.
_DEPTHSPLAT, _GAUSSIANS = (
    ("encoder.depth_predictor.", "depth_predictor."),
    ("encoder.gaussian_head.", "gaussian_head."),
)
_UNIMATCH, _DEPTH_ALONE = ("backbone.conv1.", "transformer.layers."), ("pretrained.", "upsampler.concat_projects.")


@dataclass(frozen=True)
class VitFile:
    """One ViT of a file; a number is 0 where the tensor that would tell it is not there."""

    prefix: str  # of its tensor names, with the dot
    layout: str
    hidden: int
    layers: int
    patch: int
    mlp_ratio: float
    grid: int  # its position embedding is stored for grid x grid patches
    registers: bool
    swiglu: bool
    depth_head: bool  # beside it lies the head of Depth-Anything

    @property
    def root(self) -> str:
        """What the names of a head beside it are prefixed with."""
        return self.prefix.removesuffix("pretrained.").removesuffix("backbone.").removesuffix("dinov2.")

    @property
    def name(self) -> str:
        family = "Depth-Anything" if self.depth_head else "DINOv2"
        size = SIZES.get((self.hidden, self.layers))
        shape = f"width {self.hidden}, {self.layers} layers, patches of {self.patch} px, {self.grid} x {self.grid} grid"
        kind = f"{family} {size}/{self.patch}" if size else f"{family}-type ViT"
        return f"{kind}{' with registers' if self.registers else ''} ({shape})"

    @property
    def licence(self) -> str:
        """As Depth-Anything-V2's page states it by size; an encoder without the head does not tell whose it is."""
        if (self.hidden, self.layers) not in SIZES or not self.depth_head:
            return ""
        return "Apache-2.0" if self.hidden == 384 else "CC-BY-NC-4.0"

    def fits(self, config: VitConfig) -> bool:
        return (self.hidden, self.layers, self.patch) == (config.hidden, config.layers, config.patch)

    def recognised(self, wanted: VitConfig) -> Recognised:
        """The words of a report on loading this into a ViT of the shape `wanted`."""
        return Recognised(self.name, f"{self.layout}, names under {self.prefix!r}", self.licence, self._hint(wanted))

    def _hint(self, wanted: VitConfig) -> str:
        held = f"These are the tensors of {self.name}"
        if not self.fits(wanted):
            presets = [name for name, config in PRESETS.items() if self.fits(config.semantic_vit)]
            cure = f"use preset {' or '.join(presets)}" if presets else "no preset has that size"
            size = SIZES.get((wanted.hidden, wanted.layers), "a ViT")
            asked = f"{size} of width {wanted.hidden}, {wanted.layers} layers and patches of {wanted.patch} px"
            return f"{held}, asked for is {asked}: {cure}."
        if self.grid * self.patch != wanted.image_size:
            pixels = self.grid * self.patch
            return f"{held}: give VitConfig image_size={pixels}, its position embedding is for {pixels} px."
        return f"{held}, the size that is asked for: the file is cut short, or of another variant of it."


def find_vit(path: Path, tensors: Mapping[str, Tensor], prefix: str | None = None) -> VitFile:
    """The ViT among `tensors`, under `prefix` where the file has several.

    Raises `CheckpointError` when there is none, or several and no prefix that chooses.
    """
    found: dict[tuple[str, bool], int] = {}
    for name in tensors:
        for pattern, original in ((_ANCHORS_TRANSFORMERS, False), (_ANCHORS_ORIGINAL, True)):
            if match := pattern.match(name):
                found[match["prefix"], original] = found.get((match["prefix"], original), 0) + 1
                break
    if prefix is not None:
        found = {key: count for key, count in found.items() if key[0] == prefix}
    if not found:
        some = ", ".join(sorted(tensors)[:5])
        under = f" under {prefix!r}" if prefix is not None else ""
        kind = network_kind(tensors) if prefix is None else ""
        raise CheckpointError(
            f"{path} holds no ViT of DINOv2's kind{under}: no class token, position or patch embedding among its "
            f"{len(tensors)} tensors ({some}, …); expected are the files of DINOv2 or Depth-Anything-V2"
            + (f"; it holds {kind}" if kind else "")
        )
    if len(found) > 1:
        places = ", ".join(repr(key[0]) for key in sorted(found))
        raise CheckpointError(f"{path} holds {len(found)} ViTs, under {places}; say which by its prefix")
    (prefix, original), _ = found.popitem()
    return _measure(tensors, prefix, original)


def looks_like(path: Path, tensors: Mapping[str, Tensor]) -> str:
    """Which network these tensors belong to and which command takes it; empty where that cannot be told."""
    if kind := network_kind(tensors):
        return kind
    try:
        vit = find_vit(path, tensors)
    except CheckpointError:
        return ""
    taken_by = [name for name, config in PRESETS.items() if config.freeze_vits and vit.fits(config.semantic_vit)]
    presets = [] if vit.registers or vit.swiglu else taken_by
    option = "--depth-weights" if vit.depth_head else "--semantic-weights"
    taken = f"{option} of a training of preset {' or '.join(presets)} takes" if presets else "no preset has"
    return f"{vit.name}, which {taken}"


def network_kind(names: Collection[str]) -> str:
    """DepthSplat's or UniMatch's network, told from the names of its tensors alone, and what takes it; empty if it is
    neither."""

    wrapper = wrapper_of(names)

    def has(*beginnings: str) -> bool:
        return any(name.removeprefix(wrapper).startswith(beginnings) for name in names)

    if has(*_DEPTHSPLAT) and has(*_GAUSSIANS):
        return "DepthSplat's tensors, which gapmes-export takes with --architecture depthsplat"
    trunk = all(has(beginning) for beginning in _UNIMATCH)
    if has(*_DEPTHSPLAT) or (trunk and has(*_DEPTH_ALONE)):
        return "DepthSplat's tensors for depth alone, of which --trunk-weights of a training takes the trunk"
    return "UniMatch's tensors, which --trunk-weights of a training takes" if trunk else ""


def split_block(name: str) -> tuple[int, str] | None:
    """Number and remainder of a name within a block, prefix removed; None outside the blocks."""
    match = _BLOCK.match(name)
    return (int(match["block"]), match["rest"]) if match else None


def _measure(tensors: Mapping[str, Tensor], prefix: str, original: bool) -> VitFile:
    own = {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}
    blocks = [block for name in own if (block := split_block(name))]
    rests = {rest for _, rest in blocks}
    layout = ORIGINAL if original else TRANSFORMERS_4
    if not original and any(rest.startswith("attention.q_proj.") for rest in rests):
        layout = TRANSFORMERS_5
    projection = own.get("patch_embed.proj.weight" if original else "embeddings.patch_embeddings.projection.weight")
    positions = own.get("pos_embed" if original else "embeddings.position_embeddings")
    token = own.get("cls_token" if original else "embeddings.cls_token")
    fc1 = next((value for name, value in own.items() if name.endswith("mlp.fc1.weight")), None)
    hidden = _length(projection, 0) or _length(token, -1) or _length(positions, -1)
    vit = VitFile(
        prefix=prefix,
        layout=layout,
        hidden=hidden,
        layers=1 + max((number for number, _ in blocks), default=-1),
        patch=_length(projection, -1),
        mlp_ratio=_length(fc1, 0) / hidden if hidden else 0,
        grid=round(max(_length(positions, 1) - 1, 0) ** 0.5),
        registers="register_tokens" in own or "embeddings.register_tokens" in own,
        swiglu=any(rest.startswith(("mlp.w12.", "mlp.weights_in.", "mlp.gate_proj.")) for rest in rests),
        depth_head=False,
    )
    heads = (vit.root + "depth_head.", vit.root + "neck.", vit.root + "head.conv")
    return replace(vit, depth_head=any(name.startswith(heads) for name in tensors))


def _length(tensor: Tensor | None, axis: int) -> int:
    """The length of an axis, or 0 where the tensor lacks it: a wrong file may hold anything under a known name."""
    return tensor.shape[axis] if tensor is not None and -tensor.ndim <= axis < tensor.ndim else 0
