"""Filling from behind: confirmed depths stay, occluded strips join the background, and the result is continuous."""

from __future__ import annotations

import torch

from gapmes.model.behind import ENOUGH, FAR_PREFERENCE, WINDOWS, filled_from_behind


def brute_force(inverse: torch.Tensor, confirmed: torch.Tensor) -> torch.Tensor:
    """The same in float64, pixel by pixel, for (h, w)."""
    inverse, confirmed = inverse.double(), confirmed.double()
    out = inverse.clone()
    height, width = inverse.shape
    for y in range(height):
        for x in range(width):
            left, filled = 1.0, 0.0
            for window in WINDOWS:
                r = window // 2
                part = (slice(max(0, y - r), y + r + 1), slice(max(0, x - r), x + r + 1))
                weight = confirmed[part] * torch.exp(-FAR_PREFERENCE * inverse[part])
                held = min(1.0, float(confirmed[part].mean()) / ENOUGH)
                behind = float((weight * inverse[part]).sum() / weight.sum().clamp(min=1e-15))
                filled += left * held * behind
                left *= 1 - held
            filled += left * float(inverse[y, x])
            out[y, x] = confirmed[y, x] * inverse[y, x] + (1 - confirmed[y, x]) * filled
    return out


def test_equals_brute_force_in_float64() -> None:
    generator = torch.Generator().manual_seed(0)
    for share in (0.02, 0.3, 0.9):
        inverse = torch.rand(2, 1, 20, 24, generator=generator)
        confirmed = (torch.rand(2, 1, 20, 24, generator=generator) < share).float()
        confirmed = confirmed * torch.rand(2, 1, 20, 24, generator=generator)
        got = filled_from_behind(inverse, confirmed)
        for n in range(2):
            # float32 sums of up to 33 x 33 numbers: measured 1.1e-7
            torch.testing.assert_close(
                got[n, 0].double(), brute_force(inverse[n, 0], confirmed[n, 0]), atol=1e-6, rtol=0
            )


def test_an_occluded_strip_joins_the_background() -> None:
    inverse = torch.full((1, 1, 8, 20), 0.2)
    inverse[..., 8:14] = 0.8  # an object
    confirmed = torch.ones(1, 1, 8, 20)
    confirmed[..., 6:8] = 0  # beside it, hidden in the other view and matched to anything
    inverse[..., 6:8] = 0.6
    filled = filled_from_behind(inverse, confirmed)
    assert float((filled[..., 6:8] - 0.2).abs().max()) < 1e-4
    assert torch.equal(filled[..., 8:], inverse[..., 8:])


def test_without_any_confirmation_nothing_changes() -> None:
    inverse = torch.rand(1, 1, 9, 9, generator=torch.Generator().manual_seed(1))
    torch.testing.assert_close(filled_from_behind(inverse, torch.zeros(1, 1, 9, 9)), inverse)


def test_rounding_stays_rounding() -> None:
    """Also where hardly anything is confirmed, a change of 1e-6 in the confirmation changes no result by much more."""
    generator = torch.Generator().manual_seed(2)
    inverse = torch.rand(1, 1, 40, 40, generator=generator)
    confirmed = (torch.rand(1, 1, 40, 40, generator=generator) < 0.01).float()
    moved = inverse + 1e-6 * torch.randn(inverse.shape, generator=generator)
    nearly = confirmed * (1 - 1e-6 * torch.rand(inverse.shape, generator=generator))
    change = (filled_from_behind(moved, nearly) - filled_from_behind(inverse, confirmed)).abs()
    assert float(change.max()) < 2e-5  # measured 2e-6 to 2.6e-6 over four seeds


def test_what_is_confirmed_16_px_away_fills_and_what_is_farther_off_does_not() -> None:
    inverse = torch.full((1, 1, 40, 60), 0.6)
    inverse[..., :10] = 0.2
    confirmed = torch.zeros(1, 1, 40, 60)
    confirmed[..., :10] = 1  # of a window of 33 x 33 px one column, 0.0303
    filled = filled_from_behind(inverse, confirmed)
    torch.testing.assert_close(filled[0, 0, 20, 22:28], torch.tensor([0.2] * 4 + [0.6] * 2))
