"""DepthSplat's published checkpoints: which network a file holds, and every tensor of it into ours, strictly."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from torch import Tensor

from ..checkpoint import CheckpointError
from ..pretrained.dinov2 import OPTIONAL, vit_parts
from ..pretrained.files import TensorFile, read_tensors
from ..pretrained.fit import Fit, LeftOut, Part, Recognised, fit
from ..pretrained.recognise import VitFile, find_vit
from .config import CNN_CHANNELS, FEATURES, HEAD_WIDTHS, PLAIN, VITS, Compatibility, DepthSplatConfig
from .network import DepthSplat

ROOT = "encoder."  # of the published Gaussian-splatting files, which hold the whole trainer
TRUNK = "depth_predictor."
VIT = f"{TRUNK}pretrained."
LICENCE = "MIT if it is one of the authors' own"  # as their page of models states it; a file does not tell whose it is
_HEAD = "gaussian_head."
_JOINED = "depth_predictor.upsampler.concat_projects.0.weight"
_KNOWN_BESIDE = {"decoder.": "the renderer's", "losses.": "a training loss's"}


def load_depthsplat(path: Path, compatibility: Compatibility = PLAIN) -> tuple[DepthSplat, Fit]:
    """The network that the file holds, in float32 and evaluation mode, and what became of every tensor.

    Raises `CheckpointError` for a file that cannot be read or is no DepthSplat of a published layout (naming what it
    is), and lists what is missing, unexpected or misshapen.
    """
    file = read_tensors(path)
    root = ROOT if any(name.startswith(ROOT + TRUNK) for name in file.tensors) else ""
    if not any(name.startswith(root + TRUNK) for name in file.tensors):
        some = ", ".join(sorted(file.tensors)[:5])
        raise CheckpointError(
            f"{path} is no checkpoint of DepthSplat: none of its {len(file.tensors)} tensors is named {TRUNK}* "
            f"({some}, …); expected is a depthsplat-gs-….pth"
        )
    vit = find_vit(path, file.tensors, root + VIT)
    config = recognised_config(path, file, root, vit, compatibility)
    network = DepthSplat(config)

    def names(source: str) -> tuple[Part, ...] | LeftOut | None:
        for prefix, owner in _KNOWN_BESIDE.items():
            if source.startswith(prefix):
                return LeftOut(f"{owner} state, not the network's")
        if source.startswith(vit.prefix):
            parts = vit_parts(vit, source)
            return None if parts is None else tuple(Part(f"{VIT}vit.{p.target}", p.index, p.of) for p in parts)
        return (Part(source.removeprefix(root)),) if source.startswith(root) else None

    size = f"DepthSplat {config.vit}, {config.scales} scale{'s' if config.scales > 1 else ''}"
    recognised = Recognised(size, f"DepthSplat's, names under {root!r}", LICENCE, f"It looks like {size}.")
    optional = {f"{VIT}vit.{name}": reason for name, reason in OPTIONAL.items()}
    report, tensors = fit(file, network.state_dict(), names, recognised=recognised, optional=optional)
    network.load_state_dict(tensors)
    return network.eval(), report


def recognised_config(
    path: Path, file: TensorFile, root: str, vit: VitFile, compatibility: Compatibility
) -> DepthSplatConfig:
    """Size from the ViT, number of scales from the parts that only two scales have. Raises `CheckpointError`."""
    sizes = [name for name, config in VITS.items() if vit.fits(config)]
    if not sizes:
        raise CheckpointError(f"{path}: {vit.name} is none of {', '.join(VITS)} of DepthSplat")
    tensors: Mapping[str, Tensor] = file.tensors
    if not any(name.startswith(root + _HEAD) for name in tensors):
        raise CheckpointError(
            f"{path} has no {_HEAD}*: it predicts depth alone; take a depthsplat-gs-… checkpoint, which also has "
            "Gaussians"
        )
    scales = 2 if f"{root}depth_predictor.mv_pyramid.stages.1.0.weight" in tensors else 1
    config = DepthSplatConfig(sizes[0], scales, compatibility)
    joined = tensors.get(root + _JOINED)
    wanted = sum(CNN_CHANNELS[:2]) + HEAD_WIDTHS[config.vit][0] + (FEATURES // 2 + 1 if scales == 2 else 0)
    if joined is not None and joined.ndim == 4 and joined.shape[1] != wanted:
        raise CheckpointError(
            f"{path}: {_JOINED} joins {joined.shape[1]} channels, {wanted} with features at 1/4 resolution; networks "
            "that match at 1/8 have no published checkpoint and are not supported"
        )
    return config
