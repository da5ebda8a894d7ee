"""Recipes as data: curriculum over resolution, views and baseline, learning rate, noise and loss weights."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Phase:
    """A stretch of training with one kind of batch."""

    share: float  # of all steps
    sizes: tuple[int, ...]  # px, input images, taken in turn
    scenes: int  # per step
    views: tuple[int, ...]  # numbers of input views, taken in turn
    baseline: tuple[float, float]  # in units of the median scene depth
    field_of_view: tuple[float, float] = (38.0, 78.0)  # degrees

    def __post_init__(self) -> None:
        if math.gcd(len(self.sizes), len(self.views)) > 1:
            raise ValueError(
                f"phase: {len(self.sizes)} sizes and {len(self.views)} numbers of views, both taken in turn, do not "
                "meet in every combination; give lengths without a common factor"
            )

    @property
    def label(self) -> str:
        return " and ".join(map(str, sorted(set(self.sizes)))) + " px"


@dataclass(frozen=True)
class Recipe:
    """What a run depends on besides code, data, precision and what it starts from."""

    steps: int = 8_000
    seed: int = 1
    learning_rate: float = 1e-3
    warm_up: int = 200  # steps
    decay_from: float = 0.4  # share of the steps after which the learning rate decays linearly to 1 %
    weight_decay: float = 1e-4
    ema: float = 0.998
    clip: float = 1.0
    targets: int = 2
    zoom_share: float = 0.2  # of steps whose targets have twice the input resolution: keeps scales from collapsing
    noise_until: float = 0.75  # share of the steps after which there is no Gumbel noise, as in inference
    withheld_until: float = 0.75  # share of the steps after which matching evidence is no longer withheld
    close_share: float = 0.33  # share of scenes with a near occluder at the edge of one input
    aside: float = 0.3  # largest standard deviation of targets from the path of the inputs, in baselines
    input_noise: float = 0.01  # standard deviation; in half of the steps, at random
    depth_weight: tuple[float, float] = (1.0, 0.3)  # at the beginning and at the end
    ssim_weight: float = 0.2
    balance_weight: float = 0.01
    phases: tuple[Phase, ...] = (
        Phase(0.10, (64,), 4, (2, 2, 3), (0.06, 0.6)),
        Phase(0.36, (96,), 2, (2, 3, 2, 4), (0.06, 0.8), (22.0, 80.0)),
        Phase(0.32, (128,), 2, (2, 2, 3), (0.06, 0.8), (22.0, 80.0)),
        Phase(0.22, (128, 128, 256), 2, (2, 2, 2, 3), (0.06, 0.8), (22.0, 80.0)),
    )

    def phase(self, step: int) -> Phase:
        """The phase of a step; shares add up to 1."""
        position, end = step / self.steps, 0.0
        for phase in self.phases:
            end += phase.share
            if position < end - 1e-9:
                return phase
        return self.phases[-1]

    def with_scenes(self, count: int) -> Recipe:
        """The same with `count` scenes in every step."""
        return replace(self, phases=tuple(replace(phase, scenes=count) for phase in self.phases))

    def not_shared_by(self, processes: int) -> str | None:
        """Which step's scenes so many processes cannot share evenly; None where they can."""
        for phase in self.phases:
            if phase.scenes % processes:
                short = f"{processes} cannot share the {phase.scenes} scenes of a step at {phase.label} evenly"
                return f"{short}; give --scenes {processes} or a multiple of it"
        return None

    def learning_rate_at(self, step: int) -> float:
        """Linear warm-up, a plateau up to `decay_from`, linear decay to 1 %, so that the last phases still learn."""
        warm = min(1.0, (step + 1) / self.warm_up)
        left = 1 - max(0.0, step / self.steps - self.decay_from) / (1 - self.decay_from)
        return self.learning_rate * warm * (0.01 + 0.99 * left)

    def noise_scale_at(self, step: int) -> float:
        """Factor of the Gumbel noise: decays linearly from 1 to 0 at `noise_until`; always 0 if that is 0."""
        return self._annealed(step, self.noise_until)

    def withheld_at(self, step: int) -> float:
        """Probability that a process gets no matching evidence in a step, so that the network learns depth without it:
        decays linearly from 1 to 0 at `withheld_until`; always 0 if that is 0."""
        return self._annealed(step, self.withheld_until)

    def _annealed(self, step: int, until: float) -> float:
        return max(0.0, 1.0 - step / (until * self.steps)) if until else 0.0

    def depth_weight_at(self, step: int) -> float:
        start, end = self.depth_weight
        return start + (end - start) * step / self.steps


FINISH = Recipe(
    steps=1_800,
    seed=13,  # other scenes than the runs before it
    learning_rate=5e-4,
    warm_up=100,
    decay_from=0.2,
    noise_until=0.0,
    withheld_until=0.0,
    close_share=0.5,
    depth_weight=(0.6, 0.3),
    phases=(
        Phase(0.45, (96,), 2, (2, 2, 3), (0.12, 0.9), (22.0, 80.0)),
        Phase(0.55, (128, 128, 256), 2, (2, 2, 2, 3), (0.12, 0.9), (22.0, 80.0)),
    ),
)
"""`finish` goes on from trained weights, without noise, where they lose most: with inputs farther apart than in
`whole`, and something close at the edge of one in half of the scenes; the steps at 256 px come last."""
RECIPES = {"whole": Recipe(), "finish": FINISH}
