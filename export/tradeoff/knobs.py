"""The settings of scenes and pictures that the report goes through, each as its user sets it."""

from __future__ import annotations

from dataclasses import dataclass

from gapmes.service.leaving_out.budget import DEFAULT_MAX_ERROR, Budget
from gapmes.service.pictures.effort import ALPHA_MIN, STOP, Effort


@dataclass(frozen=True)
class SceneSetting:
    """What `gapmes reconstruct` leaves out."""

    knob: str
    value: str
    how: str
    budget: Budget
    default: bool = False


@dataclass(frozen=True)
class PictureSetting:
    """What `gapmes render` draws."""

    knob: str
    value: str
    how: str  # its option, empty for a default that no option sets
    effort: Effort
    default: bool = False


def _share(value: float) -> str:
    return f"{value * 255:g}/255"


FADE_PASSES = (0, 1, 2, 4, 8)
BANDS = "harmonics (random ones)"  # the shipped network yields constant colours only

SCENE_SETTINGS = (
    SceneSetting("leaving out", "nothing", "--max-error off", Budget(None)),
    SceneSetting("leaving out", "0", "--max-error 0", Budget(0.0)),
    *(
        SceneSetting(
            "leaving out", _share(error), f"--max-error {_share(error)}", Budget(error), error == DEFAULT_MAX_ERROR
        )
        for error in (1 / 255, 4 / 255, 16 / 255, 64 / 255)
    ),
    *(
        SceneSetting(
            "opacity", f"{opacity:g}", f"--max-error off --min-opacity {opacity:g}", Budget(None, min_opacity=opacity)
        )
        for opacity in (0.05, 0.2, 0.5)
    ),
    *(
        SceneSetting("pixel stride", str(stride), f"--max-error off --stride {stride}", Budget(None, stride=stride))
        for stride in (2, 4)
    ),
)
PICTURE_SETTINGS = (
    *(
        PictureSetting("alpha cut", _share(cut), f"--alpha-min {cut:.6g}", Effort(alpha_min=cut), cut == ALPHA_MIN)
        for cut in (0.1 / 255, 1 / 255, 4 / 255, 16 / 255)
    ),
    *(
        PictureSetting("early stop", f"{stop:g}", f"--stop {stop:g}", Effort(stop=stop), stop == STOP)
        for stop in (0.0, 1e-4, 1e-2, 0.1)
    ),
    *(
        PictureSetting("cut radius", f"{radius:g} sigma", f"--cut-radius {radius:g}", Effort(cut_radius=radius))
        for radius in (1.5, 2.0, 2.5, 3.0)
    ),
    PictureSetting("cut radius", "none", "", Effort(), default=True),
    *(PictureSetting("samples", f"{n} x {n}", f"--samples {n}", Effort(samples=n), n == 1) for n in (1, 2, 4)),
    *(
        PictureSetting(BANDS, f"degree {degree}", f"--sh-degree {degree}", Effort(sh_degree=degree), degree == 3)
        for degree in (0, 1, 2, 3)
    ),
)
EXACT = {
    "alpha cut": Effort(alpha_min=1e-6),
    "early stop": Effort(stop=0.0),
    "cut radius": Effort(),
    "samples": Effort(samples=4),
    BANDS: Effort(),
}
