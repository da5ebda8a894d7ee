"""Scenes with large rounding errors: found by hill climbing, and built from what it found."""

from __future__ import annotations

import numpy as np

from gapmes.service.cameras.camera import Camera
from gapmes.service.gaussians import Gaussians
from gapmes.service.splat.tile_state import TILE

# Means, scales, rotations, opacities and f_dc, of a picture of 40 x 40 px and a focal length of 40 px.
COLOUR_SCENE = (
    [
        [0.00886525364, 0.00183691064, 0.0217419878],
        [0.00975159305, -0.00093776926, 0.0660794648],
        [-0.0278406739, 0.0171944363, 0.0891333843],
        [-3.9126122, 2.53441601, 9.02121178],
        [-6.20523403, -1.25112656, 49.2386356],
    ],
    [
        [1.30438607e-05, 0.0574896708, 4.80889538e-05],
        [0.00038416758, 3.4398967e-05, 2.64193305e-05],
        [9.69178424e-05, 0.00186100936, 0.266209713],
        [0.0848335802, 0.179784954, 0.270220968],
        [48.6161798, 1.25482079e-06, 1.07552635],
    ],
    [
        [-1.42053261, -0.683665884, 0.0823353294, 0.00174961612],
        [0.127221643, 1.89202432, -0.576011348, -0.387174668],
        [-0.484756673, -1.68577868, 3.06537768, 0.994196279],
        [0.920585149, 0.746641307, -1.58931597, 0.0286660737],
        [0.787054081, 0.998238139, -0.615396771, 2.15570546],
    ],
    [0.998351163, 0.990316681, 0.999764039, 0.0250997325, 0.999718278],
    [
        [1.03387597, 0.247549724, 1.77],
        [1.66385286, -0.984874349, 0.343988429],
        [-1.6396043, 0.0522428575, 1.76954488],
        [-0.347153716, -1.77, -0.33896723],
        [0.805458319, 1.77, -1.65067206],
    ],
)
DEPTH_SCENE = (
    [
        [-0.0172809434, 0.0170802891, 0.068055437],
        [-0.0303573541, 0.0247177251, 0.104759092],
        [-0.0138330893, 0.127502672, 0.0242986033],
        [-89.4961298, -325.76579, 1740.34338],
        [547.23814, -7768.28672, 323977.227],
    ],
    [
        [0.000560744356, 0.0978755479, 0.00152372868],
        [0.000166539884, 0.0145956284, 8.58661234e-06],
        [2.89788942, 0.00249003685, 0.0818351917],
        [4.82480002, 346424.29, 20702.0303],
        [276653.819, 57355.6233, 2.01184148],
    ],
    [
        [0.0543170194, 0.410522882, 2.23565792, 1.32332216],
        [0.438684309, 0.647850619, -1.33551292, 1.09166084],
        [0.423360155, -0.324989709, 2.67665139, 0.685114633],
        [0.859976506, -0.173554188, 0.306654202, -0.0399533902],
        [-0.379386868, 0.302508674, 0.724936735, -0.0391026594],
    ],
    [0.997686684, 0.999703872, 0.0389414465, 0.0372292415, 0.999928023],
    [
        [-0.356558317, 0.910421458, 0.0668779498],
        [0.212270382, 1.30094148, 0.917493502],
        [-0.418966489, -0.958656397, -0.295302644],
        [-0.16414562, 0.453461072, -0.255546436],
        [-1.48450663, 1.2608445, -0.580943295],
    ],
)
CLIMBED = Camera.make(40, 40, 40.0, 40.0, 20.0, 20.0, np.eye(4))

# One pixel in the corner of its tile, as far from the tile's centre as it goes.
CORNER = Camera.make(1, 1, TILE / 2, TILE / 2, 0.5, 0.5, np.eye(4))
# Needles about it: length and width, turn in radians, centre (px) and opacity. The float32 alpha of ONE is off by most;
# of ABOVE and BELOW, near the default cut, by the largest share, upwards and downwards; of DENSE, near `alpha_max`, by
# the largest share of the light that it lets through.
ONE = (38.46913338281356, 0.00028412310360759766, 2.4227302493928358, 1.2121380272785098, 0.6257013517096232, 1.0)
ABOVE = (
    24.108883840736915, 0.0004803644958436498, 2.3454853407338114, -1.6264496556359216, 0.06710210557481222,
    0.9971737017217548,
)  # fmt: skip
BELOW = (
    8.442933609588307, 6.889051526802985e-05, 2.3677356705834005, 1.8946252554767773, -3.3877971493085175,
    0.9977909581998511,
)  # fmt: skip
DENSE = (115.70349486732071, 0.001645820659337827, 2.34360841366887, 1.095328148190381, -0.2219246270410754, 0.99995524)
OPAQUE = (1e4, 1e4, 0.0, 0.5, 0.5, 1.0)


def climbed(scene: tuple) -> Gaussians:
    """One of the scenes above."""
    means, scales, rotations, opacities, constant = (np.array(part, float) for part in scene)
    return Gaussians.make(means, scales, rotations, opacities, constant[:, None])


def needles(rows: list[tuple[float, ...]], colours: list[float], depths: np.ndarray | None = None) -> Gaussians:
    """Flat needles before `CORNER` with grey levels of 0 to 1; behind each other at 1 unless there are depths."""
    length, width, turn, x, y, opacity = np.array(rows).T
    z = 1 + 1e-13 * np.arange(len(rows)) if depths is None else depths
    unit = z / CORNER.fx  # of a px
    zero = np.zeros(len(rows))
    return Gaussians.make(
        np.stack([(x - CORNER.cx) * unit, (y - CORNER.cy) * unit, z], axis=1),
        np.stack([length * unit, width * unit, zero], axis=1),
        np.stack([np.cos(turn / 2), zero, zero, np.sin(turn / 2)], axis=1),
        opacity,
        ((np.array(colours) - 0.5) / 0.28209479177387814)[:, None, None] * np.ones((1, 1, 3)),
    )
