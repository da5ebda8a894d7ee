"""Stability rows of the splatter: needles, layers, ties, distant origins, against float64 or closed forms."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gapmes.service.cameras.camera import Camera
from gapmes.service.gaussians import Gaussians
from gapmes.service.harmonics import C0
from gapmes.service.splat import Definition, render, render_reference

from . import naive
from .row import Row, against_reference, edges, larger

F64 = "float64, brute force"


def view(width: int = 48, height: int = 40, focal: float = 45.0) -> Camera:
    return Camera(width, height, focal, focal, width / 2, height / 2, np.eye(4))


def cloud(count: int, seed: int, scales: tuple[float, float], depths: tuple[float, float]) -> Gaussians:
    """Log-uniform scales and depths, random rotations, opacities and colours."""
    rng = np.random.default_rng(seed)
    z = np.exp(rng.uniform(math.log(depths[0]), math.log(depths[1]), count))
    means = np.column_stack([*(rng.uniform(-0.7, 0.7, (2, count)) * z), z])
    spread = np.exp(rng.uniform(math.log(scales[0]), math.log(scales[1]), (count, 3)))
    harmonics = rng.uniform(-1.7, 1.7, (count, 1, 3))
    return Gaussians.make(means, spread, rng.standard_normal((count, 4)), rng.uniform(0, 1, count), harmonics)


def dots(means: object, opacities: object, colours: object, scale: float = 0.0) -> Gaussians:
    """Round Gaussians of one scale."""
    means = np.asarray(means, float)
    shade = (np.broadcast_to(np.asarray(colours, float), (len(means), 3)) - 0.5) / C0
    turned = np.tile([1.0, 0, 0, 0], (len(means), 1))
    return Gaussians.make(means, np.full((len(means), 3), scale), turned, opacities, shade[:, None])


def rows() -> Iterator[Row]:
    """One after the other, since some take seconds."""
    yield from (needles(), stiff(), closed_form(), many_layers(), early_stop(), ties(), threads())
    yield from (invisible(), lenses(), rigid_motion(), units(), far_world())


def needles() -> Row:
    rng, camera = np.random.default_rng(1), view(64, 64, 60.0)
    worst = plain = 0.0
    for sigma_px in (1.0, 1e2, 1e3, 1e4, 1e5):
        for thinness in (1.0, 1e4, 1e8):
            z = rng.uniform(0.5, 5.0)
            sigma = sigma_px * z / camera.fx
            at = [*(rng.uniform(-0.4, 0.4, 2) * z), z]
            scales = [[sigma, sigma / thinness, sigma / thinness]]
            one = Gaussians.make([at], scales, rng.standard_normal((1, 4)), [0.95], np.full((1, 1, 3), 1.0))
            error, true = against_reference(one, camera)
            _, alpha = naive.picture(one, camera)
            off = ~edges(one, camera, Definition(), true)
            worst, plain = larger(worst, error), larger(plain, float(np.abs(alpha - true.alpha)[off].max(initial=0.0)))
    return Row(
        "E1", "one needle", "1 to 1e5 px long, 1:1 to 1:1e8", F64, "opacity", worst, 5e-6, plain, "2-D covariance"
    )


def stiff() -> Row:
    worst = plain = 0.0
    for scales, depths in (((1e-10, 3.0), (0.3, 100.0)), ((1e-8, 3.0), (0.02, 1.0))):
        scene, camera = cloud(150, 5, scales, depths), view(64, 64, 60.0)
        error, true = against_reference(scene, camera)
        colour, _ = naive.picture(scene, camera)
        off = ~edges(scene, camera, Definition(), true)
        worst, plain = larger(worst, error), larger(plain, float(np.abs(colour - true.rgb)[off].max()))
    return Row(
        "E2",
        "stiff scenes",
        "scales 1e-10 to 3, depths 0.02 to 100",
        F64,
        "colour",
        worst,
        1e-5,
        plain,
        "2-D covariance",
    )


def closed_form() -> Row:
    camera, worst, plain = view(33, 33, 40.0), 0.0, 0.0
    y, x = np.mgrid[:33, :33] - 16.0
    for scale in (0.0, 0.01, 0.1, 1.0):
        ball = dots([[0, 0, 2.0]], [0.8], 1.0, scale)
        variance = (40.0 * float(np.float32(scale)) / 2) ** 2 + 0.3
        alpha = float(np.float32(0.8)) * np.exp(-(x**2 + y**2) / (2 * variance))
        alpha[alpha < 1 / 255] = 0.0
        worst = larger(worst, float(np.abs(render(ball, camera).alpha - alpha).max()))
        plain = larger(plain, float(np.abs(naive.picture(ball, camera)[1] - alpha).max()))
    return Row(
        "E3", "a sphere on the axis", "scale 0 to 1", "closed form", "opacity", worst, 2e-6, plain, "2-D covariance"
    )


def many_layers() -> Row:
    rule, worst, plain = Definition(stop=0.0), 0.0, 0.0
    for layers in (1, 10, 1000, 10_000):
        for opacity in (1 / 255, 0.01, 0.1, 0.99):
            means = np.column_stack([np.zeros((layers, 2)), np.linspace(1, 2, layers)])
            colours = np.column_stack([np.linspace(0, 1, layers), np.linspace(1, 0, layers), np.ones(layers)])
            image = render(dots(means, np.full(layers, opacity), colours), view(5, 5, 5.0), definition=rule)
            alpha = np.minimum(np.full(layers, np.float32(opacity), np.float64), rule.alpha_max)
            light = np.cumprod(np.concatenate([[1.0], 1 - alpha]))
            expected = (alpha * light[:-1]) @ colours
            logs = np.exp(np.cumsum(np.log1p(-alpha.astype(np.float32)), dtype=np.float32)).astype(np.float32)
            weights = alpha.astype(np.float32) * np.concatenate([[np.float32(1)], logs[:-1]])
            worst = larger(worst, float(np.abs(image.rgb[2, 2] - expected).max()))
            simple = (weights[:, None] * colours.astype(np.float32)).sum(0)
            plain = larger(plain, float(np.abs(simple - expected).max()))
    sweep = "1 to 1e4 layers of 1/255 to 0.99"
    return Row(
        "E5", "layers without early stop", sweep, "closed form", "colour", worst, 1e-5, plain, "sums of logarithms"
    )


def early_stop() -> Row:
    """The error of early stopping alone, with and without the Gaussian that finishes a pixel."""
    worst = plain = 0.0
    for layers in range(2, 21):
        for opacity in (0.9, 0.985, 1 - 2.0**-24, 1.0):
            means = np.column_stack([np.zeros((layers, 2)), 1 + 0.1 * np.arange(layers)])
            scene = dots(means, np.full(layers, opacity), np.linspace(0, 1, layers)[:, None])
            exact = render_reference(scene, view(5, 5, 5.0), definition=Definition(stop=0.0)).rgb[2, 2]
            worst = larger(worst, float(np.abs(render(scene, view(5, 5, 5.0)).rgb[2, 2] - exact).max()))
            simple, _ = naive.picture(scene, view(5, 5, 5.0), exclusive=True)
            plain = larger(plain, float(np.abs(simple[2, 2] - exact).max()))
    return Row(
        "E6",
        "opaque layers",
        "2 to 20 layers of 0.9 to 1",
        "float64 without stop",
        "colour",
        worst,
        1.01e-4,
        plain,
        "stops before adding",
    )


def ties() -> Row:
    rng, camera = np.random.default_rng(3), view()
    means = np.column_stack([rng.uniform(-1, 1, (300, 2)), np.full(300, 2.0)])
    wall = dots(means, rng.uniform(0.3, 1, 300), rng.random((300, 3)), 0.1)
    order = rng.permutation(300)
    ours = [render(some, camera).rgb for some in (wall, wall[order])]
    plain = [naive.picture(some, camera)[0] for some in (wall, wall[order])]
    difference = float(np.abs(plain[0] - plain[1]).max())
    return Row(
        "E7",
        "a wall of equal depths, input permuted",
        "300 Gaussians",
        "the same picture",
        "colour",
        float(np.abs(ours[0] - ours[1]).max()),
        0.0,
        difference,
        "order of the input",
    )


def threads() -> Row:
    scene, camera = cloud(2000, 4, (0.02, 0.3), (1.0, 6.0)), view(130, 70, 90.0)
    first = render(scene, camera, threads=1).rgb
    worst = larger(*(float(np.abs(render(scene, camera, threads=n).rgb - first).max()) for n in (1, 2, 3, 7)))
    return Row("E9", "numbers of threads", "1, 2, 3, 7", "the same picture", "colour", worst, 0.0)


def invisible() -> Row:
    scene = cloud(400, 3, (0.02, 0.3), (1.0, 6.0))
    scene.harmonics[:] = (0.7 - 0.5) / C0
    worst = float(np.abs(render(scene, view(), background=(0.7, 0.7, 0.7)).rgb - 0.7).max())
    return Row("E13", "every colour is the background's", "400 Gaussians", "constant picture", "colour", worst, 1e-6)


def lenses() -> Row:
    scene, worst = cloud(150, 12, (0.02, 0.3), (1.0, 6.0)), 0.0
    for fx, fy, cx, cy in ((4.0, 4000.0, 20.0, 20.0), (45.0, 30.0, -40.0, 60.0), (60.0, 50.0, 80.0, -36.0)):
        worst = larger(worst, against_reference(scene, Camera(40, 36, fx, fy, cx, cy, np.eye(4)))[0])
    return Row("E14", "lenses", "fy/fx to 1000, centre -1 to 2 pictures off", F64, "colour", worst, 1e-5)


def rigid_motion() -> Row:
    """The 99th percentile: pixels on a cut-off jump with the rounding of the inputs."""
    from gapmes.service.cameras.rotations import about_axis, quaternion_from_matrix, quaternion_product

    scene, camera = cloud(200, 10, (0.02, 0.3), (1.0, 6.0)), view()
    turn, shift = about_axis(np.array([0.48, -0.6, 0.64]), 2.3), np.array([1.0, -0.7, 0.4])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, shift
    turned = quaternion_product(quaternion_from_matrix(turn), scene.rotations_wxyz.astype(np.float64))
    other = Gaussians.make(scene.means @ turn.T + shift, scene.scales, turned, scene.opacities, scene.harmonics)
    pictures = render(scene, camera).rgb, render(other, camera.posed(pose)).rgb
    plain = naive.picture(scene, camera)[0], naive.picture(other, camera.posed(pose))[0]
    worst, simple = (float(np.quantile(np.abs(a - b).max(axis=2), 0.99)) for a, b in (pictures, plain))
    return Row(
        "E17",
        "the world turned and moved",
        "one rigid motion",
        "the same picture",
        "colour, 99 % of pixels",
        worst,
        1e-5,
        simple,
        "2-D covariance",
    )


def units() -> Row:
    scene, camera = cloud(200, 7, (0.02, 0.3), (1.0, 6.0)), view()
    first, worst = render(scene, camera).rgb, 0.0
    for power in (-20, -3, 5, 20):
        unit = 2.0**power
        other = replace(scene, means=scene.means * unit, scales=scene.scales * np.float32(unit))
        worst = larger(worst, float(np.abs(render(other, camera, near=0.01 * unit).rgb - first).max()))
    return Row("E18", "units", "times 2^-20 to 2^20", "the same picture", "colour", worst, 0.0)


def far_world() -> Row:
    """The pixel position of points at a focal length of 1000 px, with camera and points far from the origin."""
    from mpmath import mp

    rng, worst, plain = np.random.default_rng(9), 0.0, 0.0
    mp.dps = 40
    for offset in (0.0, 1e3, 1e5, 1e7):
        shift = offset * np.array([1.0, -0.7, 0.4])
        pose = np.eye(4)
        pose[:3, 3] = shift
        camera = Camera(1024, 1024, 1000.0, 1000.0, 512.0, 512.0, pose)
        points = shift + np.column_stack([rng.uniform(-2, 2, (50, 2)), rng.uniform(2, 8, 50)])
        exact = []
        for point in points:
            x, y, z = (mp.mpf(float(p)) - mp.mpf(float(s)) for p, s in zip(point, shift, strict=True))
            exact.append([float(1000 * x / z + 512), float(1000 * y / z + 512)])
        worst = larger(worst, float(np.abs(camera.project(points)[0] - exact).max()))
        local = (points.astype(np.float32) - shift.astype(np.float32)).astype(np.float32)
        pixels = np.float32(1000) * local[:, :2] / local[:, 2:] + np.float32(512)
        plain = larger(plain, float(np.abs(pixels - exact).max()))
    return Row(
        "E19", "a world far from its origin", "0 to 1e7 units", "40 digits", "px", worst, 5e-4, plain, "float32 world"
    )
