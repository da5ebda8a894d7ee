"""How far an exported file may be from torch, with the reason for every number.

Errors are in units of the output's largest magnitude in the torch run, in the units of a picture
(`compare.image_units`) and outside what a changed route reaches. Two budgets are kept apart. The 99th percentile and
the mean bound the smooth part, which is rounding or quantisation. The share of jumps bounds what rounding tips over an
edge of the definition: a sample that falls exactly on an image border counts as seen or not. The largest error is
reported and not limited, since a jump has no size limit of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Precision = Literal["fp32", "int8"]


@dataclass(frozen=True)
class Tolerance:
    """Limits of a precision."""

    p99: float  # of every output but the indices
    mean: float
    jumps: float  # share of elements of an output
    unambiguous_flips: float  # share of patches whose route may differ though the logits decide
    spare_flips: int  # and this many more: in a small picture one patch is already some per cent
    picture_psnr: float  # dB, least agreement of what is drawn from both results


TOLERANCES: dict[Precision, Tolerance] = {
    # FP32MEASURED
    "fp32": Tolerance(p99=2e-4, mean=2e-5, jumps=2e-3, unambiguous_flips=0.0, spare_flips=0, picture_psnr=70.0),
    # INT8MEASURED
    "int8": Tolerance(p99=4e-2, mean=4e-3, jumps=1.0, unambiguous_flips=0.02, spare_flips=2, picture_psnr=40.0),
}
