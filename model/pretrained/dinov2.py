"""DINOv2's published layouts (the original, transformers 4 and 5) into `Vit`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from torch import Tensor

from ..backbones import VitFeatures
from ..vit import Vit
from ..weights_file import CheckpointError
from .config_file import compare, read_config, stated_of_vit, vit_section
from .files import TensorFile, read_tensors
from .fit import Fit, LeftOut, Part, fit
from .recognise import ORIGINAL, VitFile, find_vit, split_block
from .sources import Source, resolve

MASK_TOKEN = "embeddings.mask_token"
OPTIONAL = {MASK_TOKEN: "not in the file; only masked pretraining reads it"}

_OUTSIDE_ORIGINAL = {
    "cls_token": "embeddings.cls_token",
    "mask_token": MASK_TOKEN,
    "pos_embed": "embeddings.position_embeddings",
    "patch_embed.proj.weight": "embeddings.patch_embeddings.projection.weight",
    "patch_embed.proj.bias": "embeddings.patch_embeddings.projection.bias",
    "norm.weight": "layernorm.weight",
    "norm.bias": "layernorm.bias",
}
_IN_BLOCK_ORIGINAL = {
    **{name: name for kind in ("weight", "bias") for name in (f"norm1.{kind}", f"norm2.{kind}")},
    **{name: name for kind in ("weight", "bias") for name in (f"mlp.fc1.{kind}", f"mlp.fc2.{kind}")},
    **{f"attn.proj.{kind}": f"attention.o_proj.{kind}" for kind in ("weight", "bias")},
    "ls1.gamma": "layer_scale1.lambda1",
    "ls2.gamma": "layer_scale2.lambda1",
}
_IN_BLOCK_TRANSFORMERS_4 = {
    "attention.attention.query": "attention.q_proj",
    "attention.attention.key": "attention.k_proj",
    "attention.attention.value": "attention.v_proj",
    "attention.output.dense": "attention.o_proj",
}


def load_vit(features: VitFeatures, source: str | Path, *, cache: Path | None = None) -> Fit:
    """Load a ViT's published weights strictly and report on every tensor.

    `source` is a file, a folder or a hub name (see `resolve`). Raises `CheckpointError`, also for a whole
    Depth-Anything-V2, so that the two are not mixed up, and then `features` is unchanged.

    On the grid that the position embedding is stored for, the result is that of the publisher's code. On another grid,
    of n patches, that code samples the embedding as if there were n + 0.1, this one as n: `tests/parity`.
    """
    found = resolve(source, cache=cache)
    report, tensors = fit_vit(read_tensors(found.path), features.vit)
    if found.config is not None:
        stated = vit_section(read_config(found.config))
        compare(found.config, stated, stated_of_vit(features.vit.config), "these weights are of another network")
    features.vit.load_state_dict(tensors, strict=True)
    return with_source(report, found)


def fit_vit(file: TensorFile, vit: Vit) -> tuple[Fit, dict[str, Tensor]]:
    """The report and the state dict for `vit`.

    Raises `CheckpointError`: see `fit`; also for variants of DINOv2 that this network is not.
    """
    held = find_vit(file.path, file.tensors)
    refuse_variants(file.path, held)
    if held.depth_head:
        raise CheckpointError(
            f"{file.path} is {held.name}: it goes into the depth backbone; the semantic one takes DINOv2 itself, for "
            f"example facebook/dinov2-base"
        )

    def names(source: str) -> tuple[Part, ...] | LeftOut | None:
        if source.startswith(held.prefix):
            parts = vit_parts(held, source)
            if parts is not None or held.prefix != held.root:
                return parts
        if source.removeprefix(held.root).startswith(("classifier.", "linear_head.")):
            return LeftOut("linear classifier on top of the ViT")
        return None

    recognised = held.recognised(vit.config)
    return fit(file, vit.state_dict(), names, recognised=recognised, optional=OPTIONAL)


def vit_parts(held: VitFile, source: str) -> tuple[Part, ...] | None:
    """The tensors of a `Vit` that one of the file's gives; None when that layout has no such name."""
    name = source.removeprefix(held.prefix)
    block = split_block(name)
    if held.layout != ORIGINAL:
        if block is None:
            return (Part(name),)
        number, rest = block
        module, _, kind = rest.rpartition(".")
        return (Part(f"encoder.layer.{number}.{_IN_BLOCK_TRANSFORMERS_4.get(module, module)}.{kind}"),)
    if block is None:
        return (Part(_OUTSIDE_ORIGINAL[name]),) if name in _OUTSIDE_ORIGINAL else None
    number, rest = block
    base = f"encoder.layer.{number}."
    if rest in ("attn.qkv.weight", "attn.qkv.bias"):
        kind = rest.rpartition(".")[2]
        return tuple(Part(f"{base}attention.{which}_proj.{kind}", i, 3) for i, which in enumerate("qkv"))
    return (Part(base + _IN_BLOCK_ORIGINAL[rest]),) if rest in _IN_BLOCK_ORIGINAL else None


def refuse_variants(path: Path, held: VitFile) -> None:
    """Raise `CheckpointError` for the published kinds of DINOv2 that are other networks, with the file to take."""
    if held.registers:
        raise CheckpointError(
            f"{path} holds register tokens ({held.name}), which this network does not have; take the variant without: "
            f"facebook/dinov2-base instead of facebook/dinov2-with-registers-base, dinov2_vitb14_pretrain.pth "
            f"instead of dinov2_vitb14_reg4_pretrain.pth"
        )
    if held.swiglu:
        raise CheckpointError(
            f"{path} has SwiGLU layers ({held.name}), as the giant of DINOv2 has, and this network has not; take "
            f"ViT-S (preset small) or ViT-B (preset base), for example facebook/dinov2-base"
        )


def with_source(report: Fit, found: Source) -> Fit:
    """The report with where the file came from, once its `config.json` was checked where it has one.

    The hub name of DINOv2 itself also tells its licence.
    """
    licence = report.licence or ("Apache-2.0" if found.repository.startswith("facebook/dinov2-") else "")
    return replace(
        report,
        repository=found.repository,
        commit=found.commit,
        licence=licence,
        config_checked=found.config is not None,
    )
