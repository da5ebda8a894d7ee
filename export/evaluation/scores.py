"""Scores of one scene and of a group of scenes: every method over all and over co-visible pixels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from gapmes.service.cameras.view_checks import Notice
from gapmes.service.commands.summary import warning_line

from ..size import Size
from .metrics import Figures, mean_figures, mean_or_none
from .routing import RoutingStatistics
from .scene_views import Photographs

NEAREST, PLANE, SWEEP, TUNED_SWEEP = "nearest input", "plane blend", "plane sweep", "tuned sweep"
TRUE_DEPTH = "true depth"
SIMPLE = (NEAREST, PLANE, SWEEP)
BASELINES = (*SIMPLE, TUNED_SWEEP)  # what a model is compared with; true depth is a ceiling, not a baseline


@dataclass(frozen=True)
class MethodScore:
    """Means over the targets of a scene, or over the scenes of a group."""

    all: Figures
    covisible: Figures


@dataclass(frozen=True)
class Twice:
    """A render at twice the size, against the truth at that size."""

    psnr: float  # dB
    change: float  # dB, relative to the PSNR at the size of the inputs
    enlarged: float  # dB, the same change for the picture at the inputs' size, upsampled
    detail: float  # dB, the same change if only the truth's finer detail were lost
    holes: float  # share of pixels with opacity below 0.5
    side_px: int  # shorter side of the truth: the photograph's crop, or as rendered; below twice ours it was upsampled


@dataclass(frozen=True)
class ModelScore:
    """The scores of a model on a scene."""

    score: MethodScore
    holes: float  # share of all pixels with opacity below 0.5
    holes_covisible: float | None  # the same among co-visible pixels
    seconds: float  # of the reconstruction, without drawing
    twice: Twice | None


@dataclass(frozen=True)
class SceneScore:
    """All methods on one scene; without true depth co-visibility comes from the first model."""

    scene: str
    covisible_share: float  # of the target pixels
    baselines: dict[str, MethodScore]  # TRUE_DEPTH among them where there is truth
    models: dict[str, ModelScore]
    photographs: Photographs | None = None  # None of generated scenes
    warnings: tuple[Notice, ...] = ()  # about the capture, then those of the first model's scene

    @property
    def best_baseline(self) -> str:
        return max(BASELINES, key=lambda name: number(self.baselines[name].all.psnr))

    def margin(self, model: str, among: Sequence[str] = BASELINES) -> float:
        """dB above this scene's best baseline `among` these, over all pixels."""
        best = max(number(self.baselines[name].all.psnr) for name in among)
        return number(self.models[model].score.all.psnr) - best


@dataclass(frozen=True)
class Group:
    """Scenes of one kind, view count and size."""

    kind: str  # "photographs" or "generated"
    inputs: int
    size: Size
    covisible_from: str  # "true depth" or "rendered depth of NAME"
    scenes: Sequence[SceneScore]
    routing: Mapping[str, RoutingStatistics | None]  # per model
    left_out: Mapping[str, str] = field(default_factory=dict)  # scene -> reason
    seed: int | None = None  # of generated scenes
    whole: bool = False  # photographs were not cropped to the aspect of `size`

    @property
    def title(self) -> str:
        kind = self.kind if self.seed is None else f"{self.kind} (seed {self.seed})"
        return f"{kind}, {self.inputs} views, {self.size} px" + (", whole photographs" if self.whole else "")

    @property
    def models(self) -> list[str]:
        return list(self.scenes[0].models)

    @property
    def told(self) -> list[tuple[str, str]]:
        """Scenes of photographs, with the lines of their warnings."""
        scenes = [scene for scene in self.scenes if scene.photographs is not None]
        return [(scene.scene, warning_line(notice)) for scene in scenes for notice in scene.warnings]

    def methods(self) -> dict[str, MethodScore]:
        """Name -> mean over scenes, for every baseline and model."""
        names = list(self.scenes[0].baselines)
        means = {name: mean_score([scene.baselines[name] for scene in self.scenes]) for name in names}
        return means | {name: mean_score([s.models[name].score for s in self.scenes]) for name in self.models}

    def margins(self, model: str, among: Sequence[str] = BASELINES) -> list[float]:
        """dB above each scene's own best baseline."""
        return [scene.margin(model, among) for scene in self.scenes]

    def margin_of_means(self, model: str) -> tuple[str, float]:
        """The baseline with the highest mean PSNR, and the model's mean PSNR above it, dB."""
        means = self.methods()
        best = max(BASELINES, key=lambda name: number(means[name].all.psnr))
        return best, number(means[model].all.psnr) - number(means[best].all.psnr)


def mean_score(scores: Sequence[MethodScore]) -> MethodScore:
    return MethodScore(mean_figures([s.all for s in scores]), mean_figures([s.covisible for s in scores]))


def mean_of(values: Sequence[float | None]) -> float:
    """Mean of the values that are not None, of which there must be one."""
    return number(mean_or_none(values))


def number(value: float | None) -> float:
    """`value`, a score over all pixels, which is never None."""
    if value is None:
        raise ValueError("a figure over all pixels is missing")
    return value
