"""The bound of leaving out at a pixel where rounding moves both pictures apart, layer after layer."""

import numpy as np
import pytest

from gapmes.service.cameras.camera import Camera
from gapmes.service.gaussians import Gaussians
from gapmes.service.leaving_out.pruning import colour_range, largest_change, prune, removal_bound, rounding
from gapmes.service.splat import Definition, render

SH_C0 = 0.28209479177387814
PIXEL = Camera.make(1, 1, 1.0, 1.0, 0.5, 0.5, np.eye(4))
FAINT, FAINTER = 0.00395, 0.003925
F32 = np.float32


def alpha(opacity: float) -> np.float32:
    """The alpha of a Gaussian centred in the pixel."""
    return render(behind_each_other([opacity], [0.0]), PIXEL, outputs=("peaks",)).peaks[0]


def behind_each_other(opacities, constants) -> Gaussians:
    """Round ones in the middle of the pixel, with grey constant bands."""
    count = len(opacities)
    z = np.linspace(1, 2, count)
    return Gaussians.make(
        np.outer(z, [0, 0, 1]),
        np.full((count, 3), 0.01),
        np.tile([1.0, 0, 0, 0], (count, 1)),
        opacities,
        np.repeat(np.asarray(constants, float).reshape(count, 1, 1), 3, axis=2),
    )


class Pixel:
    """What the splatter does to one pixel in float32."""

    def __init__(self) -> None:
        self.light, self.colour = F32(1), F32(0)

    def exact(self, share: np.float32, colours):
        """The colour with a layer of any of `colours`, before it is rounded."""
        return float(F32(share * self.light)) * np.asarray(colours, float) + float(self.colour)

    def add(self, share: np.float32, colour: np.float32) -> None:
        self.colour = F32(self.exact(share, colour))
        self.light = F32(self.light - F32(share * self.light))


def adverse(brightest: float, from_light: float) -> tuple[Gaussians, np.ndarray]:
    """2,300 faint layers of nearly `brightest`, a black one that may go, and a dense one that the whole never reaches.

    The colour of each layer behind the black one is chosen so that the whole picture is rounded down, the lean one up.
    """
    whole, lean, share = Pixel(), Pixel(), alpha(FAINT)
    top = F32((brightest - 0.5) / SH_C0)
    opacities, constants, gone = [], [], []

    def put(opacity: float, constant: float, goes: bool = False) -> None:
        opacities.append(opacity)
        constants.append(constant)
        gone.append(goes)

    while whole.light > from_light:
        for pixel in (whole, lean):
            pixel.add(share, F32(0.5 + SH_C0 * float(top)))
        put(FAINT, top)
    whole.add(alpha(FAINTER), F32(0))
    put(FAINTER, -2.0, True)
    while whole.light > F32(1e-4):
        width = min(4e-7 / float(share * whole.light), 0.3)
        choice = np.unique(((np.linspace(brightest - width, brightest, 3000) - 0.5) / SH_C0).astype(F32))
        choice = choice[choice <= top]
        colours = (0.5 + SH_C0 * choice.astype(float)).astype(F32)
        up, down = (pixel.exact(share, colours) for pixel in (lean, whole))
        best = int(np.argmax(up.astype(F32) - up - (down.astype(F32) - down)))
        for pixel in (whole, lean):
            pixel.add(share, colours[best])
        put(FAINT, choice[best])
    put(1.0, top)
    return behind_each_other(opacities, constants), np.array(gone)


@pytest.mark.case("S1")
@pytest.mark.parametrize(("brightest", "from_light"), [(1.1, 0.3), (1.05, 0.3), (1.1, 0.5)])
def test_what_rounding_adds_up_to_is_in_the_bound(brightest, from_light):
    """Measured at (1.1, 0.3): a change of 1.55e-3, of which the mass that goes is 1.17e-3 times 1.1."""
    scene, gone = adverse(brightest, from_light)
    before, after = (render(some, PIXEL, outputs=("alpha",)) for some in (scene, scene[~gone]))
    change = largest_change([after], [before])
    mass = float(render(scene, PIXEL, outputs=("removed",), subset=gone).removed.max())
    assert change > (mass + 2 * Definition().stop + 2e-5) * colour_range(scene)
    assert change <= removal_bound(scene, gone, [PIXEL])
    budget = 10 * mass * colour_range(scene)
    found = prune(scene, [PIXEL], budget, may_go=gone, worth=0, pictures=1)
    assert found.dropped == 1
    assert change == found.actual <= found.bound <= budget


def test_layers_that_the_stop_cuts_off_do_not_count():
    limits = [rounding(rule, 10**6) for rule in (Definition(), Definition(stop=0.01), Definition(alpha_min=0.1))]
    assert 2345 * 2.0**-24 < limits[0] < 1.5e-4
    assert limits[0] > limits[1] > limits[2]
    assert rounding(Definition(), 10) == 14 * 2.0**-24
    assert rounding(Definition(stop=1.0), 10) == 5 * 2.0**-24
    assert rounding(Definition(alpha_min=1e-30, stop=0.0), 1000) == 1004 * 2.0**-24
