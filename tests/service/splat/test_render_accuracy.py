"""The splatter against its float64 reference, against closed forms and against 60-digit arithmetic."""

import mpmath as mp
import numpy as np
import pytest
from splat_cases import camera, compare, dots, rotation, scene

from gapmes.service.cameras.camera import Camera
from gapmes.service.gaussians import Gaussians
from gapmes.service.splat import Definition, render, render_reference

# Largest difference off the edges of cuts; measured 7.5e-7 on scenes of 600 to 2,500 Gaussians at 64 to 160 px.
SMOOTH = 2e-6
DEPTH = 5e-6  # the sum of weights times depths is divided by 1 - T, which float32 rounds by 6e-8: measured 2.3e-6


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("seed", [1, 2])
def test_random_scenes_match_the_reference(seed, degree):
    rng = np.random.default_rng(seed)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation(rng), rng.standard_normal(3)
    base = scene(120, seed, degree)
    placed = Gaussians.make(
        base.means @ pose[:3, :3].T + pose[:3, 3], base.scales, base.rotations_wxyz, base.opacities, base.harmonics
    )
    result = compare(placed, camera(pose=pose), background=(0.2, 0.5, 1.0))
    assert result.smooth < SMOOTH
    assert result.depth < DEPTH
    assert result.jump <= 1.8 / 255  # colours reach 1.8 here, and one flip per pixel is all these seeds have
    assert result.on_edge < 5e-3


@pytest.mark.case("E2")
@pytest.mark.parametrize(
    ("scales", "near_far"), [((1e-10, 3.0), (0.3, 100.0)), ((1e-8, 3.0), (0.02, 1.0))], ids=["wide range", "needles"]
)
def test_stiff_scenes_match_the_reference(scales, near_far):
    result = compare(scene(150, 5, 0, scales, near_far), camera(64, 64, 60.0))
    assert result.smooth < SMOOTH
    assert result.depth < DEPTH


@pytest.mark.case("E1")
@pytest.mark.parametrize("sigma_px", [1.0, 30.0, 100.0, 1e3, 1e4, 1e5, 1e8])
@pytest.mark.parametrize("thinness", [1.0, 1e4, 1e8])
def test_one_needle_of_any_length(sigma_px, thinness):
    """Measured at most 2.1e-6 over 1,080 needles of 1 to 1e8 px; the bound leaves room for other compilers."""
    rng = np.random.default_rng(int(sigma_px + thinness) % 1000)
    for _ in range(4):
        pose = np.eye(4)
        pose[:3, :3] = rotation(rng)
        view = camera(64, 64, 60.0, pose)
        z = rng.uniform(0.5, 5.0)
        sigma = sigma_px * z / view.fx
        # A centre off the middle by up to a sigma, but with the image inside the footprint.
        uv = rng.uniform(-0.4, 0.4, 2)
        needle = Gaussians.make(
            [pose[:3, :3] @ [*(uv * z), z]],
            [[sigma, sigma / thinness, sigma / thinness]],
            rng.standard_normal((1, 4)),
            [0.95],
            rng.uniform(-1.7, 1.7, (1, 1, 3)),
        )
        result = compare(needle, view)
        assert render(needle, view).stats["projected"] == 1
        assert result.smooth < 5e-6


@pytest.mark.case("E1")
@pytest.mark.parametrize("sigma_px", [30.0, 1e3, 1e5, 1e8])
def test_the_tail_of_a_needle_whose_middle_is_far_away(sigma_px):
    """Up to three sigma away, at all angles: the offset from its middle has more digits than float32 holds, and across
    the needle they count."""
    rng, view = np.random.default_rng(3), camera(40, 40, 40.0)
    seen = 0
    for angle in rng.uniform(0, np.pi, 12):
        along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        middle = rng.uniform(-3, 3) * sigma_px * along + rng.uniform(-10, 10) * across
        needle = Gaussians.make(
            [[*middle / view.fx, 1.0]],
            [[sigma_px / view.fx, 0.0, 0.0]],
            [[np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)]],
            [0.95],
            np.zeros((1, 1, 3)),
        )
        ours, true = render(needle, view), render_reference(needle, view)
        assert compare(needle, view).smooth < SMOOTH
        for row, column in np.argwhere(true.alpha > 0.01)[::40]:
            exact = float(alpha_by_definition(needle, view, int(row), int(column)))
            assert abs(true.alpha[row, column] - exact) < 1e-14 * sigma_px + 1e-12
            assert abs(ours.alpha[row, column] - exact) < 5e-6
            seen += 1
    assert seen > 10


def alpha_by_definition(gaussians: Gaussians, view: Camera, row: int, column: int) -> mp.mpf:
    """Opacity times exp(-d^T Sigma^-1 d / 2) of the first Gaussian at a pixel centre, covariance form, 60 digits."""
    mp.mp.dps = 60
    matrix = lambda value: mp.matrix(np.asarray(value, dtype=np.float64).tolist())  # noqa: E731
    world = matrix(view.rotation.T)
    x, y, z = world * matrix((gaussians.means[0] - view.center)[:, None])
    w, i, j, k = (mp.mpf(float(v)) for v in gaussians.rotations_wxyz[0])
    n = w * w + i * i + j * j + k * k
    own = mp.matrix(
        [
            [1 - 2 * (j * j + k * k) / n, 2 * (i * j - w * k) / n, 2 * (i * k + w * j) / n],
            [2 * (i * j + w * k) / n, 1 - 2 * (i * i + k * k) / n, 2 * (j * k - w * i) / n],
            [2 * (i * k - w * j) / n, 2 * (j * k + w * i) / n, 1 - 2 * (i * i + j * j) / n],
        ]
    )
    fx, fy = mp.mpf(view.fx), mp.mpf(view.fy)
    jacobian = mp.matrix([[fx / z, 0, -fx * x / z**2], [0, fy / z, -fy * y / z**2]])
    half = jacobian * world * own * mp.diag([mp.mpf(float(s)) for s in gaussians.scales[0]])
    sigma = half * half.T + mp.mpf(0.3) * mp.eye(2)
    d = mp.matrix([column + mp.mpf("0.5") - fx * x / z - view.cx, row + mp.mpf("0.5") - fy * y / z - view.cy])
    return mp.mpf(float(gaussians.opacities[0])) * mp.exp(-(d.T * mp.inverse(sigma) * d)[0] / 2)


@pytest.mark.case("E1")
@pytest.mark.parametrize("sigma_px", [3.0, 1e4])
def test_a_needle_in_sixty_digits(sigma_px):
    rng = np.random.default_rng(8)
    view = camera(32, 32, 30.0)
    sigma = sigma_px * 2.0 / view.fx
    needle = Gaussians.make(
        [[0.1, -0.2, 2.0]],
        [[sigma, 1e-7 * sigma, 1e-3 * sigma]],
        rng.standard_normal((1, 4)),
        [0.9],
        np.zeros((1, 1, 3)),
    )
    ours, true = render(needle, view), render_reference(needle, view)
    rows, columns = np.nonzero(true.alpha > 0.01)
    assert len(rows) > 8
    for at in range(0, len(rows), max(len(rows) // 8, 1)):
        exact = float(alpha_by_definition(needle, view, int(rows[at]), int(columns[at])))
        assert abs(true.alpha[rows[at], columns[at]] - exact) < 1e-10
        assert abs(ours.alpha[rows[at], columns[at]] - exact) < 5e-6


@pytest.mark.case("E1")
@pytest.mark.parametrize("length", [1e10, 1e13, 1e16, 1e20])
def test_a_needle_longer_than_float64_has_digits_in_sixty(length):
    """Half a pixel thick; its middle is in the picture."""
    rng, view, lit = np.random.default_rng(2), camera(16, 16, 50.0), 0
    for _ in range(6):
        needle = Gaussians.make(
            [[0.02, -0.03, 1.0]], [[length, 1e-3, 2e-3]], rng.standard_normal((1, 4)), [0.9], np.zeros((1, 1, 3))
        )
        ours, true = render(needle, view), render_reference(needle, view)
        for row, column in rng.integers(0, 16, (6, 2)):
            exact = float(alpha_by_definition(needle, view, int(row), int(column)))
            exact = exact if exact >= 1 / 255 else 0.0
            lit += exact > 0
            assert abs(true.alpha[row, column] - exact) < 1e-10
            assert abs(ours.alpha[row, column] - exact) < 5e-6
    assert lit > 5


@pytest.mark.case("E3")
@pytest.mark.parametrize("scale", [0.0, 0.01, 0.1, 1.0])
def test_on_axis_sphere_has_a_closed_form(scale):
    view = camera(33, 33, 40.0)
    image = render(dots([[0.0, 0.0, 2.0]], [0.8], (1.0, 0.5, 0.25), scale), view)
    rows, columns = np.mgrid[:33, :33] - 16.0
    variance = (view.fx * np.float32(scale).astype(float) / 2.0) ** 2 + 0.3
    alpha = np.float64(np.float32(0.8)) * np.exp(-(rows**2 + columns**2) / (2 * variance))
    drawn = alpha >= 1 / 255
    assert np.abs(image.alpha - np.where(drawn, alpha, 0.0)).max() < 2e-6
    assert np.abs(image.rgb - image.alpha[..., None] * (1.0, 0.5, 0.25)).max() < 2e-6
    # 1 - T loses what the last bit of T = 1 holds: 3e-8 over an opacity of at least 1/255.
    assert np.abs(image.depth - np.where(drawn, 2.0, 0.0)).max() < 2.0 * 2e-5


@pytest.mark.case("E3")
def test_edge_on_disk_has_a_closed_form():
    view = camera(33, 33, 40.0)
    half_turn = np.sqrt(0.5)
    disk = Gaussians.make(
        [[0.0, 0.0, 2.0]], [[0.2, 0.2, 0.0]], [[half_turn, half_turn, 0.0, 0.0]], [0.7], np.zeros((1, 1, 3))
    )
    rows, columns = np.mgrid[:33, :33] - 16.0
    across = (view.fx * np.float64(np.float32(0.2)) / 2.0) ** 2 + 0.3
    alpha = np.float64(np.float32(0.7)) * np.exp(-(columns**2) / (2 * across) - rows**2 / (2 * 0.3))
    assert np.abs(render(disk, view).alpha - np.where(alpha >= 1 / 255, alpha, 0.0)).max() < 2e-6


@pytest.mark.case("E5")
@pytest.mark.parametrize("layers", [1, 10, 1000, 10_000])
@pytest.mark.parametrize("opacity", [1e-6, 1e-3, 1 / 255, 0.1, 0.99])
def test_many_layers_without_early_stop(layers, opacity):
    """One rounding of the transmittance, 3e-8, per layer until it has decayed; below 1e-5 for all alphas >= 1/255.

    Fainter layers, which the default `alpha_min` leaves out, may add up to 3e-8 each: 3e-4 for 10,000 of them.
    """
    z = np.linspace(1.0, 2.0, layers)
    means = np.stack([np.zeros(layers), np.zeros(layers), z], axis=1)
    colours = np.stack([np.linspace(0, 1, layers), np.linspace(1, 0, layers), np.ones(layers)], axis=1)
    rule = Definition(alpha_min=1e-9, stop=0.0)
    image = render(dots(means, np.full(layers, opacity), colours), camera(5, 5, 5.0), definition=rule)
    alpha = np.minimum(np.full(layers, np.float32(opacity), dtype=np.float64), rule.alpha_max)
    light = np.cumprod(np.concatenate([[1.0], 1.0 - alpha]))
    weights = alpha * light[:-1]
    tolerance = max(1e-5, 3e-8 * min(layers, 1 / opacity))
    assert abs(1.0 - image.alpha[2, 2] - light[-1]) < tolerance
    assert np.abs(image.rgb[2, 2] - weights @ colours).max() < tolerance


@pytest.mark.case("E6")
@pytest.mark.parametrize("opacity", [1.0, 1 - 2.0**-24])
@pytest.mark.parametrize("layers", range(1, 21))
def test_opaque_layers_stop_after_the_second(layers, opacity):
    """T is 1e-2, then 0.99998e-4 <= stop: the second layer is added, the third is not."""
    means = np.stack([np.zeros(layers), np.zeros(layers), 1.0 + 0.1 * np.arange(layers)], axis=1)
    colours = np.eye(3)[np.minimum(np.arange(layers), 2)]
    a = Definition().alpha_max
    assert a == np.float32(a)
    assert (1 - a) ** 2 < (1 - 1e-6) * Definition().stop  # farther off than float64 rounds, in whatever order
    expected = [a, a * (1 - a) if layers > 1 else 0.0, 0.0]
    for draw in (render, render_reference):
        image = draw(dots(means, np.full(layers, opacity), colours), camera(5, 5, 5.0))
        assert np.abs(image.rgb[2, 2] - expected).max() < 1e-6


@pytest.mark.case("E8")
def test_alphas_at_the_cut_flip_by_one_level_at_most():
    """Dots whose value one pixel away from their centre lies within 1e-6 of 1/255, both sides."""
    rng = np.random.default_rng(4)
    view = camera(64, 64, 64.0)
    rows, columns = (axis.ravel() for axis in np.mgrid[3:64:6, 3:64:6])
    offset = 1.0 + rng.uniform(0.2, 1.0, len(rows))
    opacity = np.exp(offset**2 / 0.6) / 255 * (1 + rng.uniform(-1e-6, 1e-6, len(rows)))
    means = np.stack([(columns + 0.5 + offset - 32) / 64, (rows + 0.5 - 32) / 64, np.ones(len(rows))], axis=1)
    keep = opacity < 0.9
    result = compare(dots(means[keep], opacity[keep], (1.0, 1.0, 1.0)), view)
    assert result.on_edge > 0.005
    assert result.smooth < SMOOTH
    assert result.jump <= 1 / 255 + 1e-5
