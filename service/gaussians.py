"""The set of 3D Gaussians that everything else passes around: linear scales, plain opacities, world frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from types import EllipsisType

import numpy as np
from numpy.typing import NDArray

from .errors import GaussiansError

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Selection = slice | NDArray[np.bool_] | NDArray[np.integer] | Sequence[int]

GAUSSIANS_CURE = "give those of a scene, or what read_gaussians returns"  # where something else was given
_UNIT = 2.0**-23  # from 1: lengths in float64 of unit rows that were rounded to float32
_TAIL = {"means": (3,), "scales": (3,), "rotations_wxyz": (4,), "opacities": ()}


@dataclass(frozen=True, eq=False, repr=False)
class Gaussians:
    """N Gaussians; build them with `Gaussians.make`, which checks shapes, finiteness and ranges once.

    `means`: (N, 3) world, caller's units; float64 so that a far-off origin costs nothing.
    `scales`: (N, 3) standard deviations along the own axes, caller's units, >= 0.
    `rotations_wxyz`: (N, 4) unit quaternions, own axes to world.
    `opacities`: (N,) in [0, 1].
    `harmonics`: (N, K, 3) SH coefficients in 3DGS order and sign, K = (degree + 1)^2.

    The arrays must not change afterwards: what was prepared to draw them is kept. For other values make another set
    (`dataclasses.replace`).
    """

    means: F64
    scales: F32
    rotations_wxyz: F32
    opacities: F32
    harmonics: F32

    @classmethod
    def make(
        cls, means: object, scales: object, rotations_wxyz: object, opacities: object, harmonics: object
    ) -> Gaussians:
        """Check and build; quaternions are normalised, also those that are too short for float32, and an all-zero one
        becomes the identity.

        Raises `GaussiansError` that names the field, the first offending index and how many there are.
        """
        given: dict[str, NDArray] = {
            "means": _array("means", means, np.float64),
            "scales": _array("scales", scales, np.float32),
            "rotations_wxyz": _array("rotations_wxyz", rotations_wxyz, np.float32),
            "opacities": _array("opacities", opacities, np.float32),
            "harmonics": _array("harmonics", harmonics, np.float32),
        }
        count = len(given["means"])
        for name, tail in _TAIL.items():
            if given[name].shape != (count, *tail):
                raise GaussiansError(f"shape is {given[name].shape}, need {(count, *tail)}", field=name)
        shape = given["harmonics"].shape
        if len(shape) != 3 or shape[0] != count or shape[1] not in (1, 4, 9, 16) or shape[2] != 3:
            raise GaussiansError(f"shape is {shape}, need ({count}, 1|4|9|16, 3)", field="harmonics")
        for name, value in given.items():
            need = "a finite number" if value.dtype == np.float64 else "a finite number within float32"
            _require(name, np.isfinite(value), value, need)
        _require("scales", given["scales"] >= 0, given["scales"], "at least 0")
        _require("opacities", (given["opacities"] >= 0) & (given["opacities"] <= 1), given["opacities"], "in [0, 1]")
        wxyz = given["rotations_wxyz"]
        short = np.abs(wxyz).max(axis=1, initial=0.0) < np.finfo(np.float32).tiny
        if short.any():  # float32 holds few of their digits, or none
            wide = np.asarray(rotations_wxyz, np.float64)
            largest = np.abs(wide).max(axis=1, keepdims=True)
            wxyz = np.where(short[:, None], wide / np.where(largest > 0, largest, 1.0), wxyz)
        given["rotations_wxyz"] = normalized_quaternions(wxyz)
        return cls(**given)

    def __len__(self) -> int:
        return len(self.means)

    def __repr__(self) -> str:
        return f"<{len(self)} Gaussians of SH degree {self.sh_degree}>"

    @property
    def sh_degree(self) -> int:
        return round(self.harmonics.shape[1] ** 0.5) - 1

    def __getitem__(self, selection: Selection) -> Gaussians:
        """The subset that a mask, slice or index array selects, in its order. Raises `TypeError` for one number and for
        arrays of several axes."""
        if isinstance(selection, tuple):  # numpy would take each for an axis of its own
            selection = list(selection)
        axes = 1 if isinstance(selection, slice | EllipsisType) else np.ndim(selection)
        if axes == 0:
            raise TypeError(f"{selection} selects no set: give a slice such as [{selection}:][:1]")
        if axes > 1:
            raise TypeError(f"indices with {axes} axes select no set: give a mask or indices with one axis")
        return Gaussians(*(getattr(self, field.name)[selection] for field in fields(self)))


def joined(*sets: Gaussians) -> Gaussians:
    """All of several sets of the same degree, in order."""
    return Gaussians(*(np.concatenate([getattr(one, field.name) for one in sets]) for field in fields(Gaussians)))


def without_zero_bands(gaussians: Gaussians) -> Gaussians:
    """The same set without the highest harmonic bands that are 0 in all of it: the same colours to the bit."""
    used = np.flatnonzero(gaussians.harmonics.any(axis=(0, 2)))
    degree = math.isqrt(int(used[-1])) if used.size else 0
    if degree == gaussians.sh_degree:
        return gaussians
    return replace(gaussians, harmonics=np.ascontiguousarray(gaussians.harmonics[:, : (degree + 1) ** 2]))


def normalized_quaternions(wxyz: F32 | F64) -> F32:
    """(N, 4) unit quaternions; dividing by the largest component first is right from 1e-44 to 1e38. Zero: identity.

    Rows that are as near to unit length as float32 holds it stay as they are, so that rotations of a file that is read
    and written again are the same to the bit.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        own = wxyz.astype(np.float32)
        unit = np.abs(np.linalg.norm(own.astype(np.float64), axis=1) - 1) <= _UNIT
    q = wxyz.astype(np.float64)
    largest = np.abs(q).max(axis=1, keepdims=True, initial=0.0)
    zero = largest[:, 0] == 0
    q = q / np.where(largest > 0, largest, 1.0)
    q[zero] = (1.0, 0.0, 0.0, 0.0)
    return np.where(unit[:, None], own, q / np.linalg.norm(q, axis=1, keepdims=True)).astype(np.float32)


def _array(name: str, value: object, dtype: type[np.floating]) -> NDArray:
    """In C order. Raises `GaussiansError` for what is not numbers; what overflows becomes infinite."""
    try:
        found = np.asarray(value)
        if found.dtype.kind in "cSU":
            raise TypeError(f"{found.dtype} is no type of real numbers")
        with np.errstate(over="ignore"):
            return np.ascontiguousarray(found, dtype=dtype)
    except (TypeError, ValueError, OverflowError, RuntimeError) as error:  # torch raises the last for its gradients
        message = f"is a {type(value).__name__} that gives no real numbers: {error!s:.200}"
        raise GaussiansError(message, field=name, cure="give an array of float32") from error


def _require(name: str, ok: NDArray[np.bool_], value: NDArray, need: str) -> None:
    if ok.all():
        return
    rows = np.flatnonzero(~ok.reshape(len(ok), -1).all(axis=1))
    first = int(rows[0])
    raise GaussiansError(
        f"{len(rows)} of {len(ok)} rows are outside the range, first at index {first}: {value[first].tolist()}, "
        f"need {need}",
        field=name,
        index=first,
        count=len(rows),
    )
