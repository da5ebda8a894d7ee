"""DepthSplat's published checkpoints: which network a file holds, and every tensor of it into ours, strictly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from torch import Tensor

from ..overflow import refuse_overflow
from ..pretrained.dinov2 import OPTIONAL, vit_parts
from ..pretrained.files import TensorFile, read_tensors
from ..pretrained.fit import Fit, LeftOut, Part, Recognised, fit
from ..pretrained.recognise import VitFile, find_vit, looks_like
from ..weights_file import CheckpointError, some, wrapper_of
from .config import COARSEST, PLAIN, SCALE_MAX, VITS, Compatibility, DepthSplatConfig
from .dpt import joined_channels
from .network import DepthSplat

ROOT = "encoder."  # of the published Gaussian-splatting files, which hold the whole trainer
TRUNK = "depth_predictor."
VIT = f"{TRUNK}pretrained."
LICENCE = "MIT if it is one of the authors' own"  # as their page of models states it; a file does not tell whose it is
_HEAD = "gaussian_head."
_JOINED = "depth_predictor.upsampler.concat_projects.0.weight"
# Largest scales other than SCALE_MAX that the authors' commands give published files (small and base, trained last at
# 448x768), by the first digits of a file's sha256, with which its name ends.
_SCALE_MAXIMA = {"c08188db": 0.1, "f8ddd845": 0.1}
_KNOWN_BESIDE = {"decoder.": "the renderer's", "losses.": "a training loss's"}


def load_depthsplat(
    path: Path, compatibility: Compatibility = PLAIN, scale_max: float | None = None
) -> tuple[DepthSplat, Fit]:
    """The network that the file holds, in float32 and evaluation mode, and what became of every tensor.

    `scale_max` is the largest scale of a Gaussian in the network's units, which no tensor tells. None takes the value
    that the authors run a published file with, if its sha256 or the end of its name is known, else 3.

    Raises `CheckpointError` for a file that cannot be read or is no DepthSplat of a published layout (naming what it
    is), for tensors that are missing, unexpected or misshapen (listing them), and for a network that overflows.
    """
    file = read_tensors(path)
    wrapper = wrapper_of(file.tensors)
    root = wrapper + (ROOT if any(name.startswith(wrapper + ROOT + TRUNK) for name in file.tensors) else "")
    if not any(name.startswith(root + TRUNK) for name in file.tensors):
        kind = looks_like(path, file.tensors)
        if "gapmes.config" in file.metadata:
            kind = "a checkpoint of ours, which gapmes-export takes without --architecture"
        raise CheckpointError(
            f"{path} is no checkpoint of DepthSplat: none of its {len(file.tensors)} tensors is named {TRUNK}* "
            f"({some(sorted(file.tensors))}); expected is a depthsplat-gs-….pth"
            + (f"; it holds {kind}" if kind else "")
        )
    vit = find_vit(path, file.tensors, root + VIT)
    if scale_max is None:
        known = [value for digits, value in _SCALE_MAXIMA.items() if digits in (file.sha256[:8], path.stem[-8:])]
        scale_max = known[0] if known else SCALE_MAX
    config = recognised_config(path, file, root, vit, compatibility, scale_max)
    network = DepthSplat(config)

    def names(source: str) -> tuple[Part, ...] | LeftOut | None:
        for prefix, owner in _KNOWN_BESIDE.items():
            if source.startswith(wrapper + prefix):
                return LeftOut(f"{owner} state, not the network's")
        if source.startswith(vit.prefix):
            parts = vit_parts(vit, source)
            return None if parts is None else tuple(Part(f"{VIT}vit.{p.target}", p.index, p.of) for p in parts)
        return (Part(source.removeprefix(root)),) if source.startswith(root) else None

    size = f"DepthSplat {config.vit}, {_counted(config.scales)}, matched first at 1/{config.coarsest}"
    size += f", Gaussians of at most {config.scale_max:g} units of the network"
    recognised = Recognised(size, f"DepthSplat's, names under {root!r}", LICENCE, f"It looks like {size}.")
    optional = {f"{VIT}vit.{name}": reason for name, reason in OPTIONAL.items()}
    report, tensors = fit(file, network.state_dict(), names, recognised=recognised, optional=optional)
    network.load_state_dict(tensors)
    refuse_overflow(path, network.eval())
    return network, report


def recognised_config(
    path: Path, file: TensorFile, root: str, vit: VitFile, compatibility: Compatibility, scale_max: float
) -> DepthSplatConfig:
    """Size from the ViT, number of scales from the parts that only two scales have, the coarsest resolution from how
    many maps are joined at 1/2. Raises `CheckpointError`."""
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
    plain = DepthSplatConfig(sizes[0], scales, compatibility, scale_max=scale_max)
    joined = tensors.get(root + _JOINED)
    if joined is None or joined.ndim != 4:
        return plain  # what is missing or misshapen is said when the tensors are fitted
    wanted = {}
    for config in (replace(plain, coarsest=coarsest) for coarsest in COARSEST):
        wanted[config.coarsest] = joined_channels(config, 0, depth=True)
        if joined.shape[1] == wanted[config.coarsest]:
            return config
    choices = " or ".join(f"{channels} if it matches first at 1/{coarsest}" for coarsest, channels in wanted.items())
    raise CheckpointError(
        f"{path}: {_JOINED} joins {joined.shape[1]} channels, DepthSplat {plain.vit} of {_counted(scales)} {choices}"
    )


def _counted(scales: int) -> str:
    return "1 scale" if scales == 1 else f"{scales} scales"
