"""Which cameras change freely, which is held, and which is named, for distances that random changes explain."""

from __future__ import annotations

import numpy as np
import pytest
from random_distances import pose_changes

HELD = np.inf
EXACT = 1.5e-4  # measured 7e-5, of changes of 4e-3


@pytest.mark.parametrize(
    ("views", "wrong", "stiffness", "culprit"),
    [
        (2, (1,), [HELD, 1], None),
        (3, (0,), [1, HELD, 4], 0),
        (3, (1,), [HELD, 1, 4], 1),
        (3, (2,), [HELD, 4, 1], 2),
        (3, (0, 2), [1, HELD, 1], None),  # two of three are all but one: held is the one beside which they change least
        (4, (3,), [HELD, 4, 4, 1], 3),
        (4, (0, 3), [1, HELD, 4, 1], None),
        (4, (0, 2, 3), [1, HELD, 1, 1], None),
        (6, (0,), [1, HELD, 4, 4, 4, 4], 0),
        (6, (1, 4), [HELD, 1, 4, 4, 1, 4], None),
    ],
)
def test_as_few_cameras_as_are_wrong_change_freely(
    views: int, wrong: tuple[int, ...], stiffness: list[float], culprit: int | None
) -> None:
    found, changes = pose_changes(views, wrong)
    assert found.stiffness().tolist() == stiffness
    assert found.culprit(views - 1) == culprit
    if views > 2:  # of two the distances do not say which is wrong
        np.testing.assert_allclose(found.changes(found.stiffness()), changes, rtol=0, atol=EXACT)


def test_where_any_camera_would_do_none_is_named() -> None:
    found, _ = pose_changes(3, ())
    assert found.culprit(0) is None


def test_stiff_cameras_take_on_less_and_still_something() -> None:
    """The middle one of three is wrong, and the last one by a hundredth of that."""
    found, changes = pose_changes(3, (1, 2))
    found.px[:] += np.einsum("nc,c->n", found.slopes[:, 2], 0.99 * changes[2])
    stiff = found.stiffness()
    assert stiff.tolist() == [HELD, 1, 4]
    sizes = [float(np.linalg.norm(found.changes(np.array([HELD, 1.0, amount]))[2])) for amount in (1.0, stiff[2], HELD)]
    assert sizes[0] > sizes[1] > sizes[2] == 0
