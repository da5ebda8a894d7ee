"""How far an exported file may be from torch, with the reason for every number.

Errors are in units of the output's largest magnitude in the torch run, in the units of a picture
(`compare.image_units`) and outside what a changed route reaches. Two budgets are kept apart. The 99th percentile and
the mean bound the smooth part, which is rounding or quantisation. The share of jumps bounds what rounding tips over an
edge of the definition: a sample that falls exactly on an image border counts as seen or not. The largest error is
reported and not limited, since a jump has no size limit of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

Precision = Literal["fp32", "int8"]


# An image of one colour has no variance, and group normalisation divides by the root of that plus 1e-5: a rounding of
# 6e-8 grows up to 300 times per layer. Measured on such images: p99 4.6e-3, mean 3.0e-4 (confidence), and no patch with
# another route.
FLAT_FACTOR = 30.0

# Where no plane fits, the first depth is noise: many planes tie, and a rounding of 1e-6 in a score decides between
# them (`model/evidence.py`), then which of its neighbours' depths a pixel takes (`model/behind.py`); a range of 1 to
# 1e6 turns what is left of that into other depths. Measured at 256 px with the shipped weights: p99 5.5e-4, mean
# 4.3e-5, jumps 2.3e-2; at 64 px under the far range, with weights of some hundred steps before: p99 2.4e-2, mean
# 7.3e-4, jumps 0.22. Nothing is right in such a scene; it must stay finite.
UNDETERMINED_P99, UNDETERMINED_MEAN, UNDETERMINED_JUMPS = 5e-2, 2e-3, 0.4


# A margin is the difference of two logits, each of which may be off by what any other output may be. Measured at 256
# px where matching is determined, as a share of the largest margin: mean 2.6e-5, p99 1.3e-4.
DIFFERENCES = {"route_margin": 2.0}


@dataclass(frozen=True)
class Tolerance:
    """Limits of a precision."""

    p99: float  # of every output but the indices
    mean: float
    jumps: float  # share of elements of an output
    unambiguous_flips: float  # share of patches whose route may differ though the logits decide
    spare_flips: int  # and this many more: in a small picture one patch is already some per cent
    picture_psnr: float  # dB, least agreement of what is drawn from both results

    def for_flat_images(self) -> Tolerance:
        """The limits for images of one colour.

        Their smooth errors come near `JUMP`, so its share says nothing there. Patches that look alike change route
        together: where quantisation may change some, it may change four times as many.
        """
        return replace(
            self,
            p99=FLAT_FACTOR * self.p99,
            mean=FLAT_FACTOR * self.mean,
            jumps=1.0,
            unambiguous_flips=4 * self.unambiguous_flips,
        )

    def for_undetermined_matching(self) -> Tolerance:
        """The limits for noise and for a range of depths whose planes all miss the scene."""
        return replace(
            self,
            p99=max(self.p99, UNDETERMINED_P99),
            mean=max(self.mean, UNDETERMINED_MEAN),
            jumps=max(self.jumps, UNDETERMINED_JUMPS),
        )


TOLERANCES: dict[Precision, Tolerance] = {
    # Largest of the cases at 256 x 256 pixels whose matching is determined: p99 1.9e-4, mean 1.4e-5, jumps 8.2e-3
    # (confidence: sums over views at borders of what they see), picture 83 dB at least. The limits leave some room for
    # other orders of sums on other processors; no other processor was tried.
    "fp32": Tolerance(p99=3e-4, mean=2e-5, jumps=1e-2, unambiguous_flips=0.0, spare_flips=0, picture_psnr=70.0),
    # Measured with the shipped weights at 256 px: p99 3.9e-2 (noise), mean 3.7e-3, 1.8 % of routes (6.9 % on images of
    # one colour), picture 74 dB at least. Limits: room for other weights and processors.
    "int8": Tolerance(p99=1e-1, mean=6e-3, jumps=1.0, unambiguous_flips=0.02, spare_flips=2, picture_psnr=40.0),
}
