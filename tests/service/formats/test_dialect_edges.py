"""From where on the signs of another dialect count, number by number, as docs/formats.md states them."""

from __future__ import annotations

import numpy as np
import pytest
from test_ply_dialects import foreign, scene

from gapmes.service.errors import InputError
from gapmes.service.formats.dialect import Dialect
from gapmes.service.formats.ply import inspect_ply


def notes(count: int, **replacement: np.ndarray) -> str:
    return " | ".join(inspect_ply(foreign(scene(count), **replacement)).notes())


@pytest.mark.parametrize("end", [0, 1])
@pytest.mark.parametrize(
    ("count", "crowd", "recognised"),
    [
        (1000, 29, True),  # ten in an even spread, and six of its standard deviations of sqrt(10) are 19 more
        (1000, 28, False),
        (999, 200, False),
        (20_000, 400, True),  # twice the 200 of an even spread, which six standard deviations would exceed at 285
        (20_000, 399, False),
    ],
)
def test_opacities_that_crowd_at_one_end_alone_are_recognised(
    end: int, count: int, crowd: int, recognised: bool
) -> None:
    values = np.concatenate([np.full(crowd, 0.009), np.linspace(0.011, 0.989, count - crowd)])
    opacity = np.abs(end - values)
    assert ("taken as they are" in notes(count, opacity=opacity)) == recognised


@pytest.mark.parametrize("end", [0, 1])
@pytest.mark.parametrize(("far", "recognised"), [(10, True), (9, False)])
def test_opacities_reach_the_other_end_with_a_hundredth_of_the_rows(end: int, far: int, recognised: bool) -> None:
    values = np.concatenate([np.full(100, 0.005), np.linspace(0.2, 0.89, 900 - far), np.full(far, 0.91)])
    assert ("taken as they are" in notes(1000, opacity=np.abs(end - values))) == recognised


@pytest.mark.parametrize(
    ("count", "small", "largest", "apart", "recognised"),
    [
        (1600, 0.2, 1.0, 3.9, True),  # neighbours are 3.9/sqrt(1600) = 0.0975 apart: a unit is more than ten times that
        (1600, 0.2, 1.0, 4.1, False),
        (1600, 0.2, 1.001, 1.0, False),
        (1600, 0.1998, 1.0, 1.0, False),
        (1000, 0.2, 1.0, 1.0, True),
        (999, 0.3, 1.0, 1.0, False),
    ],
)
def test_sizes_are_recognised_from_these_numbers_on(
    count: int, small: float, largest: float, apart: float, recognised: bool
) -> None:
    """A fifth within a tenth of the largest, some of them 0, and a few outliers; half of the positions at either end of
    a line."""
    sizes = np.full(3 * count, largest)
    sizes[: round(small * sizes.size)] = 0.099
    sizes[:3], sizes[-5:] = 0.0, 3.0
    lines = {"x": np.repeat([100 - apart, 100 + apart], [count // 2, count - count // 2]), "y": np.zeros(count)}
    scales = {f"scale_{axis}": sizes[axis::3] for axis in range(3)}
    assert ("scales were taken as they are" in notes(count, **lines, z=np.zeros(count), **scales)) == recognised


@pytest.mark.parametrize(
    ("count", "negative_first", "negative_last", "noted"),
    [
        (1000, 100, 0, True),
        (1000, 99, 0, False),
        (1000, 0, 0, False),
        (1000, 500, 1, False),
        (999, 500, 0, False),
    ],
)
def test_a_last_component_that_looks_like_w_is_noted(
    count: int, negative_first: int, negative_last: int, noted: bool
) -> None:
    first, last = np.full(count, 0.5), np.full(count, 0.5)
    first[:negative_first], last[:negative_last] = -0.5, -0.5
    last[-1] = 0.0
    assert ("as if the last were w" in notes(count, rot_0=first, rot_3=last)) == noted


@pytest.mark.parametrize(
    ("given", "field"),
    [
        ({"rotation": "WXYZ"}, "rotation"),
        ({"axes": "RUB"}, "axes"),
        ({"opacity": "x"}, "opacity"),
        ({"scales": 3}, "scales"),
    ],
)
def test_a_dialect_that_is_none_is_refused(given: dict, field: str) -> None:
    with pytest.raises(InputError, match="need one of") as caught:
        Dialect(**given)
    assert caught.value.field == field
