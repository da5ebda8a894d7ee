"""Which of DepthSplat's published networks, and where to follow the authors' code against the better reading."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields

from ..config import VitConfig

CNN_CHANNELS = (64, 96, 128)  # at 1/2, 1/2 and 1/4 resolution, or at 1/2, 1/4 and 1/8
COARSEST = (4, 8)  # the published networks match first at 1/4 or at 1/8 of the pictures' resolution
FEATURES = 128  # channels of the multi-view features at the coarsest resolution
WINDOWS = 2  # attention windows along each axis
PLANES = 128  # candidates of the first scale, uniform in inverse depth
SH_DEGREE = 2
SCALE_MIN, SCALE_MAX = 1e-10, 3.0  # in the network's units: the service gives it the near depth as one
LARGEST_SCALE = 1e6  # limit of `scale_max`: the far end of the widest depth range that exports are verified at

VITS: dict[str, VitConfig] = {
    "small": VitConfig(hidden=384, layers=12, heads=6, patch=14, mlp_ratio=4, image_size=518),
    "base": VitConfig(hidden=768, layers=12, heads=12, patch=14, mlp_ratio=4, image_size=518),
    "large": VitConfig(hidden=1024, layers=24, heads=16, patch=14, mlp_ratio=4, image_size=518),
}
TAPS = {"small": (3, 6, 9, 12), "base": (3, 6, 9, 12), "large": (5, 12, 18, 24)}  # layers whose tokens are read
DEPTH_HEAD = {"small": 32, "base": 48, "large": 64}  # features of the head that adds detail to the depth
FEATURE_HEAD = {"small": 64, "base": 96, "large": 128}  # features of the head that the Gaussians are read from
HEAD_WIDTHS = {"small": (48, 96, 192, 384), "base": (96, 192, 384, 768), "large": (128, 256, 512, 1024)}


@dataclass(frozen=True)
class Compatibility:
    """Switches that reproduce where the authors' code deviates from the geometry. All are off by default; the published
    weights were trained with all of them on, which `Compatibility.authors()` gives."""

    reference_intrinsics: bool = False  # project into the other view with this view's intrinsics
    corner_pixels: bool = False  # match at the corners of feature cells instead of their centres
    clamped_depths: bool = False  # divide by a depth of 0.001 units where a point lies behind the other camera
    tiled_mask: bool = False  # the mask of shifted windows in another order than the keys of several views
    camera_rotations: bool = False  # leave the Gaussians' rotations in their camera's frame
    foreign_harmonics: bool = False  # turn harmonics as if their basis were ordered and signed as in e3nn

    @staticmethod
    def authors() -> Compatibility:
        return Compatibility(**{field.name: True for field in fields(Compatibility)})

    @staticmethod
    def named(text: str) -> Compatibility:
        """`none`, `authors`, or switches separated by commas. Raises `ValueError` that lists them."""
        known = [field.name for field in fields(Compatibility)]
        if text == "authors":
            return Compatibility.authors()
        if text == "none":
            return Compatibility()
        names = [name.strip().replace("-", "_") for name in text.split(",")]
        if unknown := [name for name in names if name not in known]:
            raise ValueError(f"{unknown[0]!r} is unknown, choose none or authors alone, or of {', '.join(known)}")
        return Compatibility(**dict.fromkeys(names, True))


PLAIN = Compatibility()


@dataclass(frozen=True)
class DepthSplatConfig:
    """Everything that defines the graph; stored in every exported file."""

    vit: str  # small, base or large
    scales: int  # 1: depth at the coarsest resolution; 2: refined at twice that
    compatibility: Compatibility = PLAIN
    coarsest: int = 4  # the first scale matches at 1/4 or 1/8 of the pictures' resolution
    scale_max: float = SCALE_MAX  # of a Gaussian, in the network's units; no tensor tells it

    @property
    def preset(self) -> str:
        return f"depthsplat-{self.vit}"

    @property
    def sh_degree(self) -> int:
        return SH_DEGREE

    @property
    def upsample_factor(self) -> int:
        """From the finest matched resolution to the pictures'."""
        return self.coarsest // 2 ** (self.scales - 1)

    @property
    def size_step(self) -> int:
        """px; sides of a picture are multiples of it: the U-Net of the first scale has three levels."""
        return 4 * self.coarsest

    def to_json(self) -> str:
        return json.dumps({"architecture": "depthsplat", **asdict(self)}, sort_keys=True)

    @staticmethod
    def from_json(text: str) -> DepthSplatConfig:
        """Inverse of `to_json`; unknown keys are an error of the file."""
        values = json.loads(text)
        if values.pop("architecture", None) != "depthsplat":
            raise ValueError("the configuration is not DepthSplat's")
        values["compatibility"] = Compatibility(**values.get("compatibility", {}))
        return DepthSplatConfig(**values)
