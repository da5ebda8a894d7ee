"""The connected components of a mask that touch the border of the picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]


def from_border(mask: Mask) -> Mask:
    """(H, W) pixels of `mask` (H, W) in a 4-connected component that touches the border.

    Union-find over the runs of each row, in parallel rounds: roots are hooked onto smaller touching roots, then paths
    are compressed (Shiloach and Vishkin 1982). Few rounds suffice, however a component winds.
    """
    starts = mask.copy()
    starts[:, 1:] &= ~mask[:, :-1]
    run = np.cumsum(starts).reshape(mask.shape) * mask
    root = np.arange(run.max(initial=0) + 1)
    for edge in (run[0], run[-1], run[:, 0], run[:, -1]):
        root[edge] = 0  # the border's component
    touching = mask[:-1] & mask[1:]
    above, below = run[:-1][touching], run[1:][touching]
    while (apart := root[above] != root[below]).any():
        above, below = above[apart], below[apart]
        one, other = root[above], root[below]
        np.minimum.at(root, np.maximum(one, other), np.minimum(one, other))
        while (root[root] != root).any():
            root = root[root]
    return mask & (root[run] == 0)
