"""Filling from behind: confirmed depths stay, others take the farthest one of the smallest window that has any."""

from __future__ import annotations

import torch

from gapmes.model.behind import WINDOWS, filled_from_behind


def brute_force(inverse: torch.Tensor, confirmed: torch.Tensor) -> torch.Tensor:
    out = inverse.clone()
    height, width = inverse.shape
    for y in range(height):
        for x in range(width):
            if confirmed[y, x]:
                continue
            for window in WINDOWS:
                r = window // 2
                rows, columns = slice(max(0, y - r), y + r + 1), slice(max(0, x - r), x + r + 1)
                known = inverse[rows, columns][confirmed[rows, columns]]
                if len(known):
                    out[y, x] = known.min()
                    break
    return out


def test_equals_brute_force() -> None:
    generator = torch.Generator().manual_seed(0)
    for share in (0.02, 0.3, 0.9):
        inverse = torch.rand(2, 1, 24, 30, generator=generator)
        confirmed = torch.rand(2, 1, 24, 30, generator=generator) < share
        got = filled_from_behind(inverse, confirmed)
        for n in range(2):
            assert torch.equal(got[n, 0], brute_force(inverse[n, 0], confirmed[n, 0]))


def test_an_occluded_strip_joins_the_background() -> None:
    inverse = torch.full((1, 1, 8, 20), 0.2)
    inverse[..., 8:14] = 0.8  # an object
    confirmed = torch.ones(1, 1, 8, 20, dtype=torch.bool)
    confirmed[..., 6:8] = False  # beside it, hidden in the other view and matched to anything
    inverse[..., 6:8] = 0.6
    filled = filled_from_behind(inverse, confirmed)
    assert (filled[..., 6:8] == 0.2).all()
    assert torch.equal(filled[..., 8:], inverse[..., 8:])


def test_without_any_confirmation_nothing_changes() -> None:
    inverse = torch.rand(1, 1, 9, 9, generator=torch.Generator().manual_seed(1))
    assert torch.equal(filled_from_behind(inverse, torch.zeros(1, 1, 9, 9, dtype=torch.bool)), inverse)
