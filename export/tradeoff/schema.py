"""What the report's JSON holds; four kinds of error that are never mixed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

ROUNDS = 1e-6  # of a colour: pictures are float32


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class Rounding(_Strict):
    """Against a float64 evaluation of the same definition."""

    largest: float = Field(description="of a colour, what rounding tips over an edge of the definition included")
    p99: float = Field(description="of a colour: the smooth part")
    mean: float


class SettingError(_Strict):
    """Against the most exact setting, same weights, same pictures."""

    largest: float = Field(description="change of a colour, jumps included")
    p99: float = Field(description="change of a colour: the smooth part")
    mean: float
    psnr: float = Field(description="dB")


class ModelError(_Strict):
    """Against photographs or rendered truth that were held out; means over all pictures."""

    psnr: float
    psnr_spread: float = Field(description="standard deviation over the pictures, dB")
    ssim: float
    lpips: float | None
    pictures: int


class Bound(_Strict):
    """Proved (scenes: for the certified views, the largest of all scenes; alpha cut and cut radius: for the middle of
    the picture), beside the largest change found (scenes: in the inputs of all; both cuts: in the same pixels)."""

    bound: float
    actual: float
    held: bool = Field(description="no change found, of any scene, is beyond its own bound")

    @classmethod
    def of(cls, bounds: Sequence[float], actual: Sequence[float]) -> Bound:
        """Of one or more scenes: bound and change found of each."""
        held = all(found <= most + ROUNDS for most, found in zip(bounds, actual, strict=True))
        return cls(bound=max(bounds), actual=max(actual), held=held)


class Timing(_Strict):
    """Medians after a warm-up."""

    seconds: float
    stages: dict[str, float]
    repeats: int = Field(ge=1)


class Row(_Strict):
    """One value of one knob."""

    group: Literal["network", "scene", "picture"]
    knob: str
    value: str
    how: str = Field(description="the option that sets it")
    default: bool
    timing: Timing
    peak_mb: float | None = Field(description="of the whole process, resident")
    megabytes: float | None = Field(description="of the model file, or of the .ply")
    rounding: Rounding | None = Field(description="null for int8, whose change holds it too")
    setting: SettingError | None
    model: ModelError | None
    bound: Bound | None


class Machine(_Strict):
    """What the times depend on."""

    cpu: str
    flags: list[str]
    threads: int
    versions: dict[str, str]


class Report(_Strict):
    """The whole report."""

    format: Literal[1] = 1
    quick: bool
    machine: Machine
    scenes: list[str]
    splatter_rounding: Rounding
    rows: list[Row]
    seconds: float
