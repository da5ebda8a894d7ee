"""The authors' DepthSplat, imported from a checkout that is not part of the project, for comparison only.

What its modules import beside torch (training, rendering, logging) is not needed to run the encoder and is replaced by
empty stand-ins where it is not installed.
"""

from __future__ import annotations

import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import sys
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock

import torch
from torch import nn

STAND_INS = (
    "torchvision",
    "omegaconf",
    "hydra",
    "wandb",
    "pytorch_lightning",
    "dacite",
    "diff_gaussian_rasterization",
    "lpips",
)


class _StandIns(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    def find_spec(self, name: str, path: object = None, target: object = None) -> importlib.machinery.ModuleSpec | None:
        if name.split(".")[0] not in STAND_INS:
            return None
        return importlib.machinery.ModuleSpec(name, self, is_package=True)

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> MagicMock:
        module = MagicMock(name=spec.name)
        module.__spec__, module.__path__, module.__name__ = spec, [], spec.name
        return module

    def exec_module(self, module: object) -> None:
        pass


def encoder(depthsplat: Path, dinov2: Path, vit: str, scales: int, coarsest: int, scale_max: float) -> nn.Module:
    """Their encoder with random weights; vit `vits` or `vitb`, matching first at 1/coarsest of the resolution.

    Raises what an import of their code raises.
    """
    if not any(isinstance(finder, _StandIns) for finder in sys.meta_path):
        sys.meta_path.append(_StandIns())
    if str(depthsplat) not in sys.path:
        sys.path.insert(0, str(depthsplat))
    # their package's __init__ imports visualisers that need a display and more libraries
    for package in ("src.dataset", "src.model.encoder", "src.model.encoder.visualization"):
        if package not in sys.modules:
            shell = importlib.util.module_from_spec(importlib.machinery.ModuleSpec(package, None, is_package=True))
            shell.__path__ = [str(depthsplat / package.replace(".", "/"))]
            sys.modules[package] = shell
    module = importlib.import_module("src.model.encoder.encoder_depthsplat")
    load = torch.hub.load

    def local(_repository: str, name: str) -> nn.Module:
        return load(str(dinov2), name, source="local", pretrained=False)

    config = SimpleNamespace(
        name="depthsplat",
        num_depth_candidates=128,
        num_surfaces=1,
        gaussian_adapter=SimpleNamespace(gaussian_scale_min=1e-10, gaussian_scale_max=scale_max, sh_degree=2),
        gaussians_per_pixel=1,
        num_scales=scales,
        upsample_factor=coarsest // 2 ** (scales - 1),
        lowest_feature_resolution=coarsest,
        depth_unet_channels=128,
        grid_sample_disable_cudnn=False,
        init_sh_input_img=True,
        gaussian_regressor_channels=64,
        supervise_intermediate_depth=True,
        return_depth=True,
        train_depth_only=False,
        monodepth_vit_type=vit,
        local_mv_match=2,
    )
    torch.hub.load = local
    try:
        return module.EncoderDepthSplat(config).eval()
    finally:
        torch.hub.load = load
