"""The bound of a larger alpha cut or a smaller radius is never below the change that it makes, on random scenes."""

from dataclasses import replace

import numpy as np
import pytest

from gapmes.export.tradeoff.errors import cut_bound
from gapmes.service.cameras.camera import Camera
from gapmes.service.gaussians import Gaussians
from gapmes.service.splat import Definition

FINE = Definition(near=0.2, alpha_min=1e-6)
PLAIN = Definition(near=0.2)


@pytest.mark.parametrize("seed", range(12))
def test_no_colour_changes_by_more_than_the_bound(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = 60
    z = rng.uniform(1, 6, count)
    gaussians = Gaussians.make(
        np.concatenate([rng.uniform(-0.6, 0.6, (count, 2)) * z[:, None], z[:, None]], axis=1),
        np.exp(rng.uniform(-4, -0.5, (count, 3))),
        rng.standard_normal((count, 4)),
        rng.uniform(0, 1, count),
        rng.normal(0, 1, (count, 1 + 3 * (seed % 2), 3)),
    )
    camera = Camera.make(64, 64, 60.0, 60.0, 32.0, 32.0, np.eye(4))
    for exact, field, cuts in (
        (FINE, "alpha_min", (1e-3, 1e-2, 0.1, 0.5)),
        (PLAIN, "cut_radius", (3.0, 2.5, 2.0, 1.0)),
    ):
        before = 0.0
        for cut in cuts:
            found = cut_bound(gaussians, camera, exact, replace(exact, **{field: cut}))
            assert 0 < found.actual <= found.bound
            assert found.bound >= before  # a coarser cut leaves out more
            before = found.bound
