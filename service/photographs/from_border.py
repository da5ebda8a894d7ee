"""Which pixels of a mask are joined to the border of the picture by others of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]


def from_border(mask: Mask) -> Mask:
    """(H, W) which pixels of `mask` (H, W) are joined to one at the border, along rows and columns.

    Runs of a row are trees that hang themselves on touching ones with smaller numbers, and then on their roots, until
    none is left (Shiloach and Vishkin 1982): a few rounds, however long a way winds.
    """
    starts = mask.copy()
    starts[:, 1:] &= ~mask[:, :-1]
    run = np.cumsum(starts).reshape(mask.shape) * mask
    root = np.arange(run.max(initial=0) + 1)
    for edge in (run[0], run[-1], run[:, 0], run[:, -1]):
        root[edge] = 0  # the border's
    touching = mask[:-1] & mask[1:]
    above, below = run[:-1][touching], run[1:][touching]
    while (apart := root[above] != root[below]).any():
        above, below = above[apart], below[apart]
        one, other = root[above], root[below]
        np.minimum.at(root, np.maximum(one, other), np.minimum(one, other))
        while (root[root] != root).any():
            root = root[root]
    return mask & (root[run] == 0)
