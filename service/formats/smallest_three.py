"""Smallest-three encoding of unit quaternions: the largest component is made positive and left out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

# The other three are at most 1/sqrt(2) in magnitude. With an error of at most h in each of them the largest, which is
# at least 1/2, is off by at most 3 h to first order: |q . e| / m <= sqrt(1 - m^2) sqrt(3) h / m.
BOUND = np.sqrt(0.5)


def split(quaternions: NDArray) -> tuple[NDArray[np.int64], F64]:
    """(N,) index of the largest component of (N, 4) unit quaternions, and (N, 3) the others in their order.

    The sign is chosen so that the largest component is positive; ties go to the first.
    """
    q = np.asarray(quaternions, dtype=np.float64)
    index = np.abs(q).argmax(axis=1)
    largest = np.take_along_axis(q, index[:, None], axis=1)
    q = q * np.where(largest < 0, -1.0, 1.0)
    return index, np.take_along_axis(q, _others(index), axis=1)


def join(index: NDArray, others: F64) -> F64:
    """(N, 4) quaternions, the inverse of `split`."""
    q = np.empty((len(index), 4))
    np.put_along_axis(q, _others(index), others, axis=1)
    largest = np.sqrt(np.maximum(0.0, 1.0 - np.square(others).sum(axis=1)))
    np.put_along_axis(q, np.asarray(index, dtype=np.int64)[:, None], largest[:, None], axis=1)
    return q


def _others(index: NDArray) -> NDArray[np.int64]:
    """(N, 3) indices of the components other than `index` (N,), ascending."""
    places = np.arange(3)
    return places + (places >= np.asarray(index, dtype=np.int64)[:, None])
