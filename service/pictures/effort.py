"""Speed against accuracy of a picture: cuts and samples of the splatter, and drawing only the planes needed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..cameras.camera import Camera
from ..errors import InputError
from ..gaussians import Gaussians
from .picture import Channel

if TYPE_CHECKING:
    from ..splat import Definition, Render

ALPHA_MIN, STOP = 1 / 255, 1e-4  # the splatter's defaults
MAX_SAMPLES = 4  # per side of a pixel
# A radius of 6 leaves out nothing at the least alpha_min, which reaches 5.3. Below 1.3 the smallest splats may cover no
# pixel's centre.
LIMITS = {"alpha_min": (1e-6, 0.9), "stop": (0.0, 0.9), "cut_radius": (1.0, 6.0), "samples": (1, MAX_SAMPLES)}
_PLANES: dict[Channel, tuple[str, ...]] = {"rgb": (), "alpha": ("alpha",), "depth": ("alpha", "depth")}


@dataclass(frozen=True)
class Effort:
    """`alpha_min`: layers below this opacity are skipped; `stop`: transmittance below which a pixel is finished;
    `sh_degree`: highest band of harmonics, None for all; `samples` per side of a pixel; `cut_radius`: standard
    deviations beyond which a Gaussian is not drawn, None as far as `alpha_min` reaches.

    Raises `InputError` beyond `LIMITS`.
    """

    alpha_min: float = ALPHA_MIN
    stop: float = STOP
    sh_degree: int | None = None
    samples: int = 1
    cut_radius: float | None = None

    def __post_init__(self) -> None:
        for name, (low, high) in LIMITS.items():
            value = getattr(self, name)
            if name == "cut_radius" and value is None:
                continue
            if not low <= value <= high:
                raise InputError(f"is {value:g}, need {low:g} to {high:g}", field=name)

    def definition(self) -> Definition:
        """The splatter's definition with these cuts."""
        from ..splat import Definition

        radius = math.inf if self.cut_radius is None else self.cut_radius
        return Definition(alpha_min=self.alpha_min, stop=self.stop, cut_radius=radius)


def draw(
    gaussians: Gaussians, camera: Camera, channel: Channel = "rgb", effort: Effort | None = None, **options: Any
) -> Render:
    """Render only the planes that `channel` needs; `options` are further arguments of `render`.

    Raises `InputError` as `render` does.
    """
    from ..splat import render, render_supersampled

    effort = effort or Effort()
    options |= {"definition": effort.definition(), "sh_degree": effort.sh_degree, "outputs": _PLANES[channel]}
    if effort.samples == 1:
        return render(gaussians, camera, **options)
    return render_supersampled(gaussians, camera, effort.samples, **options)
