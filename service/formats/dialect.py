"""Dialects of .ply: opacity as logit or linear, scales as logarithms or linear, rotations as wxyz or xyzw.

No header tells which. An unusual dialect is detected from the values of a column only if no file of the usual one could
have them, and is reported; doubtful columns are read as usual, and the option that changes this is reported.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError

F64 = NDArray[np.float64]

OpacityForm = Literal["logit", "linear"]
ScaleForm = Literal["log", "linear"]
RotationOrder = Literal["wxyz", "xyzw"]
Axes = Literal["rub", "rdf"]  # of a .spz: right-up-back, or right-down-front as in a .ply

SCALE_NAMES = ("scale_0", "scale_1", "scale_2")
ROTATION_NAMES = ("rot_0", "rot_1", "rot_2", "rot_3")

_FORMS: dict[str, tuple[str, ...]] = {
    "opacity": ("auto", *get_args(OpacityForm)),
    "scales": ("auto", *get_args(ScaleForm)),
    "rotation": ("auto", *get_args(RotationOrder)),
    "axes": get_args(Axes),
}

DIALECT_CURE = "give a Dialect, or leave it out to have the form recognised"

FEWEST = 1000  # rows, for shares of them to be significant
EDGE = 0.01  # width of the outermost intervals at 0 and 1
CROWDED = 2.0  # times as many values in such an interval as a uniform distribution has
SIGMAS = 6.0  # of a uniform distribution, for significance
SPREAD = 0.01  # share of the rows that must be in each outer tenth
SMALL = 1.0  # linear sizes up to 1 would as logarithms all mean 1 to 2.7 units
LOW_TENTH = 0.2  # share of sizes in the lowest tenth, twice that of a uniform distribution
OVERLAP = 10.0  # sizes, in distances between neighbours, above those of any optimised scene
MIN_NEGATIVE = 0.1  # share of rows with a negative rot_0


@dataclass(frozen=True)
class Dialect:
    """How to read a .ply or .spz; "auto" is the usual form unless the values show otherwise."""

    opacity: Literal["auto"] | OpacityForm = "auto"
    scales: Literal["auto"] | ScaleForm = "auto"
    rotation: Literal["auto"] | RotationOrder = "auto"
    axes: Axes = "rub"  # of a .spz

    def __post_init__(self) -> None:
        for name, forms in _FORMS.items():
            if (given := getattr(self, name)) not in forms:
                need = f"need one of {', '.join(forms)}"
                raise InputError(f"is {str(given)[:50]!r}, {need}", field=name, cure="leave it out for the usual one")


STANDARD = Dialect("logit", "log", "wxyz")  # of what this service writes
AUTO = Dialect()


@dataclass(frozen=True)
class Taken:
    """How the columns are read, with remarks on the reasons."""

    opacity: OpacityForm
    scales: ScaleForm
    rotation: RotationOrder
    remarks: tuple[str, ...]


def taken_as(columns: Mapping[str, F64], dialect: Dialect) -> Taken:
    """Resolve "auto" by the columns of a file, all (N,), without rows that no dialect can read."""
    remarks: list[str] = []
    opacity = dialect.opacity if dialect.opacity != "auto" else _opacity(columns, remarks)
    scales = dialect.scales if dialect.scales != "auto" else _scales(columns, remarks)
    rotation = dialect.rotation if dialect.rotation != "auto" else _rotation(columns, remarks)
    return Taken(opacity, scales, rotation, tuple(remarks))


def _opacity(columns: Mapping[str, F64], remarks: list[str]) -> OpacityForm:
    """Linear if all are in [0, 1], spread over all of it, and concentrated next to an end.

    For logits neither 0 nor 1 is special. Values of exactly 0 or 1 do not count, since clamping produces them for any
    data.
    """
    values = columns["opacity"]
    if not len(values) or not ((values >= 0) & (values <= 1)).all():  # NaN compares as False
        return "logit"
    inside = values[(values > 0) & (values < 1)]
    even = EDGE * len(inside)
    crowd = max((inside < EDGE).sum(), (inside > 1 - EDGE).sum())
    wide = min((values < 0.1).mean(), (values > 0.9).mean()) >= SPREAD
    if len(inside) >= FEWEST and wide and crowd >= max(CROWDED * even, even + SIGMAS * np.sqrt(even)):
        remarks.append(
            f"opacities were taken as they are, not as logits: all {len(values)} lie in [0, 1] and {crowd} within "
            f"{EDGE} of one end, where an even spread has {even:.0f}; --opacity logit says otherwise"
        )
        return "linear"
    remarks.append(
        f"all {len(values)} opacities lie in [0, 1] and were read as logits, from "
        f"{_logistic(values.min()):.3g} to {_logistic(values.max()):.3g}: nothing in the file proves more; "
        "--opacity linear takes them as they are"
    )
    return "logit"


def _scales(columns: Mapping[str, F64], remarks: list[str]) -> ScaleForm:
    """Linear if all are positive, small and concentrated near 0, and as logarithms would far exceed distances."""
    values = np.stack([columns[name] for name in SCALE_NAMES])
    if not values.size or not (values >= 0).all():
        return "log"
    low, high = np.percentile(values, (1, 99))
    crowd = float((values < high / 10).mean())
    spacing = _spacing(columns)
    if values.shape[1] >= FEWEST and high <= SMALL and crowd >= LOW_TENTH and OVERLAP * spacing < 1:
        remarks.append(
            f"scales were taken as they are, not as logarithms: all are positive, 99 % up to {high:.3g}, {crowd:.0%} "
            f"within a tenth of that; as logarithms each would measure a unit or more, {1 / spacing:.0f} times the "
            "distance of neighbours; --scales log says otherwise"
        )
        return "linear"
    remarks.append(
        f"all scales are positive and were read as logarithms, sizes of {np.exp(min(low, 80.0)):.3g} to "
        f"{np.exp(min(high, 80.0)):.3g}: nothing in the file proves more; --scales linear takes them as they are"
    )
    return "log"


def _rotation(columns: Mapping[str, F64], remarks: list[str]) -> RotationOrder:
    """Always wxyz, as values do not tell; a last component that is never negative, as some write w, is reported."""
    first, last = columns[ROTATION_NAMES[0]], columns[ROTATION_NAMES[3]]
    if len(first) >= FEWEST and (last >= 0).all() and (first < 0).mean() >= MIN_NEGATIVE:
        remarks.append(
            "rot_3 is never negative and rot_0 often is, as if the last were w; rotations were read as wxyz; "
            "--rotation xyzw takes them the other way"
        )
    return "wxyz"


def _spacing(columns: Mapping[str, F64]) -> float:
    """Typical distance of neighbours on a surface: median distance from the median over sqrt(N); never 0."""
    means = np.stack([columns[axis] for axis in "xyz"], axis=1)
    distance = np.linalg.norm(means - np.median(means, axis=0), axis=1)
    return max(float(np.median(distance)) / np.sqrt(len(means)), np.finfo(np.float64).tiny)


def _logistic(value: float) -> float:
    return 1 / (1 + np.exp(-value))
