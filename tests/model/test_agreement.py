"""Cross-view cues: points on a common surface agree, floating points and hidden points are distinguished."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from gapmes.model.agreement import CONFIRMED, CUES, SHARPNESS, agreement_cues, confirmation
from gapmes.model.cost_volume import Views
from gapmes.model.warp import Warp

SIZE = 24
NEAR, FAR = 1.0, 8.0


def sideways(count: int = 2, baseline: float = 0.4) -> Views:
    """Cameras side by side that look straight along z, so that a fronto-parallel plane has one depth in every view."""
    intrinsics = torch.tensor([[1.0, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1]]).expand(1, count, 3, 3)
    poses = torch.eye(4).repeat(1, count, 1, 1)
    poses[0, :, 0, 3] = baseline * torch.arange(count)
    return Views.make(intrinsics, poses, torch.tensor([[NEAR, FAR]]))


def normalised(z: float) -> float:
    return (1 / z - 1 / FAR) / (1 / NEAR - 1 / FAR)


def maps(*depths: float) -> tuple[torch.Tensor, torch.Tensor]:
    """One plane per view, and grey images."""
    inverse = torch.tensor([normalised(z) for z in depths]).reshape(-1, 1, 1, 1).expand(-1, 1, SIZE, SIZE)
    return inverse.clone(), torch.full((len(depths), 3, SIZE, SIZE), 0.5)


@pytest.mark.parametrize("views", [2, 3, 5])
def test_a_common_plane_agrees(views: int) -> None:
    cues = agreement_cues(*maps(*[3.0] * views), sideways(views))
    assert cues.shape == (views, CUES, SIZE, SIZE)
    mean, strongest, colour, seen = cues.unbind(1)
    assert 0 < float((seen > 0).float().mean()) < 1  # some points leave the other frames
    for cue in (mean, strongest, colour):
        assert float(cue.abs().max()) < 2e-5  # float32 rounding times SHARPNESS, measured 8e-7


def test_the_sign_tells_floating_from_hidden() -> None:
    near, far = 2.0, 4.0
    cues = agreement_cues(*maps(near, far), sideways())
    floating, hidden = cues[0], cues[1]
    middle = (slice(8, 16), slice(8, 16))
    gap = torch.tensor(normalised(near) - normalised(far))
    assert float(floating[0][middle].mean()) == pytest.approx(float(torch.tanh(SHARPNESS * gap)), rel=1e-4)
    assert float(hidden[0][middle].mean()) == pytest.approx(-float(torch.tanh(SHARPNESS * gap)), rel=1e-4)
    assert float(floating[1][middle].min()) > 0.9
    assert float(hidden[1][middle].max()) == 0.0  # to be hidden is no offence


def test_colours_are_compared_where_the_point_lands() -> None:
    inverse, colours = maps(3.0, 3.0)
    colours[1] = 0.8
    cues = agreement_cues(inverse, colours, sideways())
    assert float(cues[0, 2][8:16, 8:16].mean()) == pytest.approx(0.3, abs=1e-6)


def test_every_pixel_is_compared_with_where_it_lands() -> None:
    """Random depths and colours in pictures that are not square, against float64 pixel by pixel."""
    h, w, cameras = 9, 14, sideways()
    generator = torch.Generator().manual_seed(4)
    inverse, colours = torch.rand(2, 1, h, w, generator=generator), torch.rand(2, 3, h, w, generator=generator)
    cues = agreement_cues(inverse, colours, cameras).double().numpy()
    maps = torch.cat([inverse, colours], dim=1).double().numpy()
    for r, shift in ((0, -0.4), (1, 0.4)):
        for y, x in np.ndindex(h, w):
            depth = 1 / (1 / FAR + (1 / NEAR - 1 / FAR) * maps[r, 0, y, x])
            at = x + shift / depth * w  # the cameras look along z with a focal length of one picture
            low = int(np.floor(at.clip(0, w - 1)).clip(0, w - 2))
            share = at.clip(0, w - 1) - low
            there = (1 - share) * maps[1 - r, :, y, low] + share * maps[1 - r, :, y, low + 1]
            inside = -0.5 < at < w - 0.5
            through = np.tanh(SHARPNESS * (maps[r, 0, y, x] - there[0])) * inside
            colour = np.abs(maps[r, 1:, y, x] - there[1:]).mean() * inside
            # positions of up to 14 px are rounded by 1e-6, SHARPNESS times over in the first two: measured 8.7e-6
            assert np.abs(cues[r, :, y, x] - [through, max(through, 0), colour, inside]).max() < 1e-4


def test_what_no_other_view_has_in_frame_gives_zeros() -> None:
    inverse, colours = maps(3.0, 3.0)
    cues = agreement_cues(inverse, colours, sideways(baseline=50.0))
    assert float(cues.abs().max()) == 0.0


def test_mean_and_strongest_over_sources() -> None:
    """One of the other views looks through the point: the mean is half of it, the strongest all of it."""
    cues = agreement_cues(*maps(2.0, 2.0, 6.0), sideways(3, 0.1))
    middle = cues[0][:, 10:14, 10:14].mean((1, 2))
    assert float(middle[0]) == pytest.approx(0.5 * float(middle[1]), rel=1e-3)
    assert float(middle[1]) > 0.9


def test_inverse_depths_in_the_source_against_float64() -> None:
    generator = torch.Generator().manual_seed(3)
    rays = torch.cat([torch.randn(1, 2, 50, generator=generator), torch.ones(1, 1, 50)], dim=1)
    inverse = torch.rand(1, 50, 1, generator=generator) + 0.05
    motion = torch.eye(4)[None].clone()
    c, s = 0.96, 0.28
    motion[0, :3, :3] = torch.tensor([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    motion[0, :3, 3] = torch.tensor([0.3, -0.2, 0.4])
    _, _, got = Warp.make(rays.unsqueeze(3), torch.eye(3)[None], motion).points(inverse)
    points = rays[0].double() / inverse[0, :, 0].double()
    z = (motion[0, :3, :3].double() @ points + motion[0, :3, 3:].double())[2]
    expected = torch.where(z > 0, 1 / z, torch.zeros_like(z))
    # float32 rounding of a sum of three products: measured 3e-7 relative
    torch.testing.assert_close(got[0, :, 0].double(), expected, rtol=3e-6, atol=1e-7)


def test_confirmation_is_a_ramp_around_the_limit() -> None:
    """Exactly 1 well within, exactly 0 well beyond, and 0 where no other view sees the point."""
    through = torch.tanh(SHARPNESS * CONFIRMED * torch.tensor([0.0, 0.5, 1.0, 2.0, -0.5, -2.0]))
    cues = torch.zeros(1, CUES, 1, 6)
    cues[0, 0, 0], cues[0, 3] = through, 1.0
    assert confirmation(cues).flatten().tolist() == pytest.approx([1, 1, 0.5, 0, 1, 0], abs=1e-5)
    cues[0, 3] = 0
    assert float(confirmation(cues).max()) == 0


def test_views_without_the_point_in_frame_take_no_part_in_the_means() -> None:
    """The third stands far aside: of the two others only the second counts, and their share is a half."""
    intrinsics = torch.tensor([[1.0, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1]]).expand(1, 3, 3, 3)
    poses = torch.eye(4).repeat(1, 3, 1, 1)
    poses[0, :, 0, 3] = torch.tensor([0.0, 0.1, 50.0])
    inverse, colours = maps(2.0, 6.0, 2.0)
    colours[1] = 0.8
    cues = agreement_cues(inverse, colours, Views.make(intrinsics, poses, torch.tensor([[NEAR, FAR]])))
    mean, strongest, colour, seen = (float(cue) for cue in cues[0, :, 12, 12])
    assert mean == pytest.approx(strongest)
    assert mean > 0.9
    assert colour == pytest.approx(0.3, abs=1e-6)
    assert seen == 0.5
