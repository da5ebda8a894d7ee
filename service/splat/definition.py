"""The definition of the rendered image: every constant that the splatter and its reference share, with its reason."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..arguments import real_number, shown, whole_number
from ..errors import InputError

MAX_DILATION = 1e3  # px^2


@dataclass(frozen=True)
class Definition:
    """3D Gaussian splatting (Kerbl et al. 2023) with EWA projection (Zwicker et al. 2001); the fields are its cut-offs.

    Gaussians with `z > near` are drawn; one whose opacity times falloff is below `alpha_min` at a pixel centre is
    skipped there; the one that brings the transmittance to `stop` or below is the last that a pixel blends. Raises
    `InputError` for values out of range.
    """

    dilation: float = 0.3
    """px^2, added to both image variances: no splat falls between pixel centres (the low-pass filter of 3DGS)."""

    alpha_min: float = 1 / 255
    """A layer below this moves an 8-bit pixel by less than one level, and the cut keeps footprints finite. It also
    bounds the rounding of the transmittance, at each layer at most 6e-8 of the light in front of it, to 6e-8 /
    alpha_min = 1.5e-5: layers that stop all light let at most 1 / alpha_min through in sum."""

    alpha_max: float = float(np.float32(0.99))
    """No layer is fully opaque. The value is exact in float32, so that two such layers (T = 0.99998e-4) fall
    on the same side of `stop` in every precision; 0.99 itself lands on 1e-4 give or take the rounding."""

    stop: float = 1e-4
    """What lies behind a transmittance of 1e-4 moves a colour by at most 1e-4; added inclusively, so the worst error
    is that and not stop / (1 - alpha_max) = 1e-2."""

    near: float = 0.01
    """Caller's units. A Gaussian at the camera's own plane has no projection; 0.01 is gsplat's default."""

    far: float = 1e37
    """Caller's units. Guards float32 depths against overflow; it culls nothing else."""

    fov_margin: float = 0.3
    """The affine projection is evaluated at most this share of the half field of view outside the image (1.3 tan(fov)
    in 3DGS when the principal point is central): further out it stretches splats without limit."""

    cut_radius: float = math.inf
    """Standard deviations beyond which a Gaussian is not drawn; infinity is as far as `alpha_min` reaches. Each layer
    that a smaller one leaves out changes a colour by at most opacity * exp(-cut_radius^2 / 2)."""

    inclusive_stop: bool = True
    """False leaves out the Gaussian that would finish a pixel, as the reference rasteriser does (worst error 1e-2)."""

    max_entries: int = 1 << 24
    """(tile, Gaussian) pairs per batch, 4 bytes each; several batches give the same image to the bit."""

    def __post_init__(self) -> None:
        for name in ("dilation", "alpha_min", "alpha_max", "stop", "near", "far", "fov_margin"):
            number = real_number(getattr(self, name))
            if number is None or not math.isfinite(number):
                raise InputError(f"is {shown(getattr(self, name))}, need a finite number", field=f"definition.{name}")
        # Below 1e-30 the polynomial power of two would leave the normal range of float32.
        _require("alpha_min", self.alpha_min, 1e-30, self.alpha_max)
        _require("alpha_max", self.alpha_max, self.alpha_min, 1.0)
        _require("dilation", self.dilation, 1e-3, MAX_DILATION)
        _require("stop", self.stop, 0.0, 1.0)
        _require("near", self.near, 0.0, self.far)
        _require("far", self.far, self.near, 1e37)
        _require("fov_margin", self.fov_margin, 0.0, 10.0)
        radius = real_number(self.cut_radius)
        if radius is None or not radius > 0:
            told = shown(self.cut_radius) if radius is None else f"{radius:g}"
            raise InputError(f"is {told}, need more than 0", field="definition.cut_radius")
        if whole_number(self.max_entries) is None:
            raise InputError(f"is {shown(self.max_entries)}, need a whole number", field="definition.max_entries")
        _require("max_entries", self.max_entries, 1, 1 << 31)


def _require(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise InputError(f"is {value:g}, need {low:g} to {high:g}", field=f"definition.{name}")


INRIA = Definition(near=0.2, inclusive_stop=False)
"""The constants and the stopping rule of the reference rasteriser of 3DGS: near cut 0.2, and a pixel ends before the
Gaussian that would take its transmittance below 1e-4."""

COMPATIBLE = {"inria": INRIA}
