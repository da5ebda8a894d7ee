"""How far an exported file may be from torch, per output, with the reason for every number.

Errors are in units of the output's largest magnitude in the torch run. Two budgets are kept apart. The 99th percentile
bounds the smooth part, which is rounding. The share of jumps bounds what rounding tips over an edge of the definition:
a sample that falls exactly on an image border counts as seen or not, an ambiguous patch takes one expert or another.
The largest error is reported and not limited, since a jump has no size limit of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Precision = Literal["fp32", "int8"]


@dataclass(frozen=True)
class Tolerance:
    """Limits of a precision."""

    p99: float  # of every output but the indices
    jumps: float  # share of elements of an output, beyond what patches with flipped routes explain
    unambiguous_flips: float  # share of patches whose route may differ though the logits decide


TOLERANCES: dict[Precision, Tolerance] = {
    # fp32: TOMEASURE
    "fp32": Tolerance(p99=1e-4, jumps=2e-3, unambiguous_flips=0.0),
    "int8": Tolerance(p99=5e-2, jumps=1.0, unambiguous_flips=0.02),
}
