"""Network configuration: the presets `tiny`, `small` and `base`, and the switches of the ablation study."""

from __future__ import annotations

import json
from dataclasses import MISSING, asdict, dataclass, fields, replace
from reprlib import repr as brief  # what a file holds may be of any length
from typing import Any

PIXELS_PER_CELL = 4  # the paper's s = 4: the aligned grid has a quarter of the input resolution
CELLS_PER_PATCH = 4  # a routed patch is 4 x 4 cells, that is 16 x 16 pixels
PIXELS_PER_PATCH = PIXELS_PER_CELL * CELLS_PER_PATCH
MOST = 4096  # upper limit of all counts; the widest published ViT of this kind (ViT-g) has 1536 channels
MOST_BLOCKS = 128  # upper limit of the counts in ONE_BY_ONE, which are built module by module
ONE_BY_ONE = ("layers", "cross_view_blocks", "experts")
COLDEST, HOTTEST = 1e-3, 1e3  # of the gates: logits in float32 are divided by it
MAX_DEGREE = 3  # of spherical harmonics
NAMES = ("tiny", "small", "base")
TRUNKS = ("light", "full")
# Lower limits of counts; 1 for all others. Without experts top_k may be 0; one plane has no spacing.
LEAST = {"eighth_channels": 0, "cross_view_blocks": 0, "sh_degree": 0, "top_k": 0, "depth_planes": 2}


@dataclass(frozen=True)
class VitConfig:
    """Shape of a vision transformer; `patch` is its patch size in pixels of the resized picture that it sees."""

    hidden: int
    layers: int
    heads: int
    patch: int
    mlp_ratio: int
    image_size: int  # px, the size that its position embedding is stored for

    def __post_init__(self) -> None:
        """Raises `ValueError` for counts that no network has, and for sizes that do not go together."""
        _check_kinds(self)
        if self.hidden % self.heads:
            raise ValueError(f"hidden is {self.hidden}, need a multiple of heads, which is {self.heads}")
        if self.image_size < self.patch:
            raise ValueError(f"image_size is {self.image_size} px, need at least one patch, which is {self.patch} px")


@dataclass(frozen=True)
class ModelConfig:
    """Everything that defines the graph; stored with every checkpoint and in every ONNX file."""

    preset: str
    semantic_vit: VitConfig
    depth_vit: VitConfig
    freeze_vits: bool  # frozen pretrained ViTs and full trunk (paper), or trained with the rest (tiny)
    half_channels: int  # CNN features at 1/2 resolution
    quarter_channels: int  # CNN features at 1/4 resolution
    match_channels: int  # features that are correlated in the plane sweep
    volume_channels: int  # features of the cost-volume network
    refine_channels: int  # features of the half-resolution refinement
    stream_channels: int  # C_dim of Eq. 1
    eighth_channels: int = 0  # light trunk: its cross-view transformer at 1/8 resolution
    cross_view_blocks: int = 0  # light trunk
    depth_planes: int = 64  # candidates of the plane sweep, uniform in inverse depth
    refine_candidates: int = 9
    second_candidates: int = 5
    experts: int = 6  # N_e
    top_k: int = 2  # k
    temperature: float = 0.8  # tau of Eq. 10
    sh_degree: int = 0
    trunk: str = "light"  # light, or full: UniMatch's CNN and transformer, frozen with the ViTs
    depth_head: bool = False  # the depth ViT is Depth-Anything-V2 whole, whose inverse depth is a cue
    backing: bool = True  # coarse opaque layer behind the far surface, so that no hole shows through
    without_depth: bool = False  # Table 5: no depth stream
    without_experts: bool = False  # Table 5: no feature-learning experts and no gate for them
    without_tasks: bool = False  # Table 5: no task gate, every head reads the full map

    def __post_init__(self) -> None:
        """Raises `ValueError` for counts and names that no network has, and for routing that means nothing."""
        _check_kinds(self)
        if self.preset not in NAMES:
            raise ValueError(f"preset is {brief(self.preset)}, need one of {', '.join(NAMES)}")
        if self.trunk not in TRUNKS:
            raise ValueError(f"trunk is {brief(self.trunk)}, need one of {', '.join(TRUNKS)}")
        if self.sh_degree > MAX_DEGREE:
            raise ValueError(f"sh_degree is {self.sh_degree}, need at most {MAX_DEGREE}: a .ply holds no more")
        if not self.without_experts and not 1 <= self.top_k <= self.experts:
            raise ValueError(f"top_k is {self.top_k}, need 1 to {self.experts}: the network has so many experts")
        number = type(self.temperature) in (int, float)
        if not (number and COLDEST <= self.temperature <= HOTTEST):
            raise ValueError(f"temperature is {brief(self.temperature)}, need a number of {COLDEST:g} to {HOTTEST:g}")

    @property
    def size_step(self) -> int:
        """px; sides of a picture are multiples of it."""
        return PIXELS_PER_PATCH

    @property
    def streams(self) -> tuple[str, ...]:
        """Names of the aligned streams in channel order."""
        return ("texture", "semantic") if self.without_depth else ("depth", "texture", "semantic")

    def to_json(self) -> str:
        return json.dumps(asdict(self), sort_keys=True)

    @staticmethod
    def from_json(text: str) -> ModelConfig:
        """Inverse of `to_json`; unknown keys are an error of the file, not ignored."""
        try:
            document = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise ValueError(f"configuration is no JSON: {error}") from error
        values = _complete("configuration", document, ModelConfig)
        for name in ("semantic_vit", "depth_vit"):
            values[name] = VitConfig(**_known(name, _complete(name, values[name], VitConfig), VitConfig))
        return ModelConfig(**_known("configuration", values, ModelConfig))


def _complete(name: str, value: Any, kind: type[VitConfig | ModelConfig]) -> dict[str, Any]:
    """A copy of the object `value`. Raises `ValueError` where it is none, or lacks a field that has no default."""
    if not isinstance(value, dict):
        raise ValueError(f"{name} is {brief(value)}, need an object with its fields")
    needed = [field.name for field in fields(kind) if field.default is MISSING]
    if lacking := [field for field in needed if field not in value]:
        raise ValueError(f"{name} lacks {', '.join(lacking)} ({len(lacking)} of the {len(needed)} fields it needs)")
    return dict(value)


def _known(name: str, value: dict[str, Any], kind: type[VitConfig | ModelConfig]) -> dict[str, Any]:
    """`value` itself. Raises `ValueError` for a field that `kind` does not have."""
    if unknown := sorted(value.keys() - {field.name for field in fields(kind)}):
        raise ValueError(
            f"{name} has the unknown field {brief(unknown[0])}: a newer version of gapmes may have written it"
        )
    return value


def _check_kinds(config: VitConfig | ModelConfig) -> None:
    """Raises `ValueError` unless switches are booleans and counts are whole numbers within their limits."""
    for field in fields(config):
        value, least = getattr(config, field.name), LEAST.get(field.name, 1)
        if field.type == "bool" and type(value) is not bool:
            raise ValueError(f"{field.name} is {brief(value)}, need true or false")
        most = MOST_BLOCKS if field.name in ONE_BY_ONE else MOST
        if field.type == "int" and not (type(value) is int and least <= value <= most):
            raise ValueError(f"{field.name} is {brief(value)}, need a whole number of {least} to {most}")


_VIT_TINY = VitConfig(hidden=96, layers=3, heads=4, patch=16, mlp_ratio=2, image_size=256)
_VIT_S = VitConfig(hidden=384, layers=12, heads=6, patch=14, mlp_ratio=4, image_size=518)
_VIT_B = VitConfig(hidden=768, layers=12, heads=12, patch=14, mlp_ratio=4, image_size=518)

# What the paper's sizes have in common; the channels are those of the full trunk.
_FULL: dict[str, Any] = {
    "trunk": "full",
    "depth_head": True,
    "freeze_vits": True,
    "half_channels": 96,
    "quarter_channels": 256,
    "sh_degree": 2,
}

PRESETS: dict[str, ModelConfig] = {  # by `NAMES`
    "tiny": ModelConfig(
        preset="tiny",
        semantic_vit=_VIT_TINY,
        depth_vit=_VIT_TINY,
        freeze_vits=False,
        half_channels=32,
        quarter_channels=64,
        eighth_channels=96,
        cross_view_blocks=2,
        match_channels=32,
        volume_channels=80,
        refine_channels=48,
        stream_channels=32,
    ),
    "small": ModelConfig(
        preset="small",
        semantic_vit=_VIT_S,
        depth_vit=_VIT_S,
        match_channels=64,
        volume_channels=128,
        refine_channels=64,
        stream_channels=96,
        **_FULL,
    ),
    "base": ModelConfig(
        preset="base",
        semantic_vit=_VIT_B,
        depth_vit=_VIT_B,
        match_channels=128,
        volume_channels=240,
        refine_channels=96,
        stream_channels=224,
        depth_planes=128,
        **_FULL,
    ),
}


def preset(name: str, **changes: object) -> ModelConfig:
    """The named preset with fields replaced; raises `KeyError` that lists the names when it is unknown."""
    if name not in PRESETS:
        raise KeyError(f"preset {name!r} is unknown, choose one of {', '.join(PRESETS)}")
    return replace(PRESETS[name], **changes)  # type: ignore[arg-type]
