"""Speed against accuracy of a picture: cuts and samples of the splatter, and drawing only the planes needed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..cameras.camera import Camera
from ..errors import InputError
from ..gaussians import Gaussians
from .picture import Channel

if TYPE_CHECKING:
    from ..splat import Render

ALPHA_MIN, STOP = 1 / 255, 1e-4  # the splatter's defaults
MAX_SAMPLES = 4  # per side of a pixel
LIMITS = {"alpha_min": (1e-6, 0.9), "stop": (0.0, 0.9), "samples": (1, MAX_SAMPLES)}
_PLANES: dict[Channel, tuple[str, ...]] = {"rgb": (), "alpha": ("alpha",), "depth": ("alpha", "depth")}


@dataclass(frozen=True)
class Effort:
    """`alpha_min`: layers below this opacity are skipped; `stop`: transmittance below which a pixel is finished;
    `sh_degree`: highest band of harmonics, None for all; `samples` per side of a pixel.

    Raises `InputError` beyond `LIMITS`.
    """

    alpha_min: float = ALPHA_MIN
    stop: float = STOP
    sh_degree: int | None = None
    samples: int = 1

    def __post_init__(self) -> None:
        for name, (low, high) in LIMITS.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise InputError(f"is {value:g}, need {low:g} to {high:g}", field=name)


def draw(
    gaussians: Gaussians, camera: Camera, channel: Channel = "rgb", effort: Effort | None = None, **options: Any
) -> Render:
    """Render only the planes that `channel` needs; `options` are further arguments of `render`.

    Raises `InputError` as `render` does.
    """
    from ..splat import Definition, render, render_supersampled

    effort = effort or Effort()
    options |= {"definition": Definition(alpha_min=effort.alpha_min, stop=effort.stop), "sh_degree": effort.sh_degree}
    options["outputs"] = _PLANES[channel]
    if effort.samples == 1:
        return render(gaussians, camera, **options)
    return render_supersampled(gaussians, camera, effort.samples, **options)
