"""LPIPS with AlexNet features (Zhang et al. 2018): a learned perceptual distance between two pictures."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from gapmes.service.errors import InputError

from ..pretrained.safetensors_file import read_safetensors
from ..weights_file import CheckpointError

F32 = NDArray[np.float32]

WEIGHTS = "lpips_alexnet.safetensors"
SHIFT = (-0.030, -0.088, -0.188)  # of pictures in [-1, 1]: mean and deviation of what AlexNet was trained on
SCALE = (0.458, 0.448, 0.450)
# (output channels, input channels, kernel), stride and padding of the five convolutions; pooling before 1 and 2
LAYERS = (
    ((64, 3, 11), 4, 2),
    ((192, 64, 5), 1, 2),
    ((384, 192, 3), 1, 1),
    ((256, 384, 3), 1, 1),
    ((256, 256, 3), 1, 1),
)
POOLED = (1, 2)
LEAST_SIDE = 32  # px; below that the pooled maps are empty


def default_weights() -> Path | None:
    """The weights in a folder `shared/weights` beside the checkout, where there is one."""
    path = Path(__file__).resolve().parents[3] / "shared" / "weights" / WEIGHTS
    return path if path.is_file() else None


class Lpips:
    """Holds the weights: `net.{i}.weight|bias` of five convolutions and `NetLinLayer_{i}.0.weight` (1, C, 1, 1)."""

    def __init__(self, weights: dict[str, Tensor]) -> None:
        """Raises `InputError` that names a tensor which is missing, misshapen or not finite."""
        for i, ((out, channels, kernel), _, _) in enumerate(LAYERS):
            shapes = {
                f"net.{i}.weight": (out, channels, kernel, kernel),
                f"net.{i}.bias": (out,),
                f"NetLinLayer_{i}.0.weight": (1, out, 1, 1),
            }
            for name, shape in shapes.items():
                found = tuple(weights[name].shape) if name in weights else "missing"
                if found != shape:
                    raise InputError(f"{name} is {found}, need {shape}", field="lpips")
                if bad := int((~torch.isfinite(weights[name])).sum()):
                    numbers = weights[name].numel()
                    raise InputError(f"{name}: {bad} of {numbers} numbers are NaN or infinite", field="lpips")
        self._weights = {name: value.float() for name, value in weights.items()}
        digest = hashlib.sha256()
        for name, value in sorted(self._weights.items()):
            digest.update(name.encode() + value.contiguous().numpy().tobytes())
        self.fingerprint = digest.hexdigest()  # equal for equal weights, whatever file they came from

    @classmethod
    def load(cls, path: Path) -> Lpips:
        """Read a .safetensors file. Raises `InputError` where it is none or holds other weights."""
        try:
            return cls(read_safetensors(path)[0])
        except CheckpointError as error:
            raise InputError(str(error), field="lpips") from error

    def distance(self, a: F32, b: F32, mask: NDArray[np.bool_] | None = None) -> float:
        """Distance of two (3, H, W) pictures in [0, 1], at least 32 px; 0 when they are equal.

        Under a mask (H, W) every position of a feature map counts by the share of its cell that the mask covers; a
        feature still sees pixels beyond the mask.
        """
        height, width = a.shape[1:]
        if min(height, width) < LEAST_SIDE:
            raise InputError(f"picture is {width} x {height} px, need at least {LEAST_SIDE}", field="lpips")
        kept = torch.ones(1, 1, height, width) if mask is None else torch.from_numpy(mask)[None, None].float()
        total = 0.0
        with torch.no_grad():
            maps = zip(self._features(a), self._features(b), strict=True)
            for i, (one, other) in enumerate(maps):
                difference = F.conv2d((one - other).square(), self._weights[f"NetLinLayer_{i}.0.weight"])
                rows, columns = difference.shape[-2:]
                weight = F.adaptive_avg_pool2d(kept, (rows, columns))
                total += float((difference * weight).sum() / weight.sum())
        return total

    def _features(self, picture: F32) -> list[Tensor]:
        """Activations after each convolution, of unit length over the channels."""
        shift, scale = (torch.tensor(v).reshape(1, 3, 1, 1) for v in (SHIFT, SCALE))
        x = (2 * torch.from_numpy(np.ascontiguousarray(picture, dtype=np.float32))[None] - 1 - shift) / scale
        maps = []
        for i, (_, stride, padding) in enumerate(LAYERS):
            if i in POOLED:
                x = F.max_pool2d(x, 3, 2)
            x = F.relu(F.conv2d(x, self._weights[f"net.{i}.weight"], self._weights[f"net.{i}.bias"], stride, padding))
            maps.append(x / (x.square().sum(dim=1, keepdim=True).sqrt() + 1e-10))
        return maps
