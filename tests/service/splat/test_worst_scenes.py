"""The rounding errors that docs/splatting.md states, on scenes searched for large errors."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from splat_cases import Edges, camera, compare
from worst_scenes import (
    ABOVE,
    BELOW,
    CLIMBED,
    COLOUR_SCENE,
    CORNER,
    DENSE,
    DEPTH_SCENE,
    ONE,
    OPAQUE,
    climbed,
    needles,
)

from gapmes.service.cameras.camera import Camera
from gapmes.service.gaussians import Gaussians
from gapmes.service.splat import Definition, render, render_reference
from gapmes.service.splat.reference import sh_basis

PAGE = " ".join((Path(__file__).parents[3] / "docs" / "splatting.md").read_text(encoding="utf-8").split())


def number(pattern: str) -> float:
    """The number of the page that stands where the pattern has one in parentheses."""
    found = re.search(pattern, PAGE)
    assert found, pattern
    return float(found[1])


ALPHA, ALPHA_LEAST = number(r"off by at most ([\d.e-]+) d \+"), number(r"d \+ ([\d.e-]+) of itself")
SINGLE = number(r"\| colour and opacity of one Gaussian, however long \| ([\d.e-]+) R")
COLOUR = number(r"\| colour and opacity \| ([\d.e-]+) R")
LAYER = number(r"\| colour and opacity \| [\d.e-]+ R, and of a colour ([\d.e-]+) R for each layer")
LIGHT = number(r"\| light that is left, depth weighted by the opacity, of themselves \| ([\d.e-]+)")
SQUARED = number(r"d\^2 lies within ([\d.e-]+) of where")
EDGES = Edges(number(r"alpha within ([\d.e-]+) of itself of"), number(r"leaves within ([\d.e-]+) of itself of `stop`"))


@pytest.mark.parametrize("band", [1, 2, 3])
def test_the_page_bounds_what_a_band_changes(band):
    """Reached by coefficients that are the basis in the Gaussian's own direction, of norm 1."""
    told = re.search(r"their coefficients times ([\d.]+), ([\d.]+), ([\d.]+) for bands", PAGE)
    assert told
    towards = np.array([[0.2, -0.3, 1.0]])
    harmonics = np.zeros((1, 16, 3))
    basis = sh_basis(towards / np.linalg.norm(towards), 3)[0, band**2 : (band + 1) ** 2]
    harmonics[0, band**2 : (band + 1) ** 2] = (basis / np.linalg.norm(basis))[:, None]
    one = Gaussians.make(towards, [[1.0, 1.0, 1.0]], [[1.0, 0, 0, 0]], [1.0], harmonics)
    view, rule = camera(5, 5, 5.0), Definition(alpha_max=1.0)
    change = np.abs(render(one, view, definition=rule).rgb - render(one, view, definition=rule, sh_degree=0).rgb).max()
    assert 0.99 * float(told[band]) < change <= float(told[band])


def test_a_radius_may_change_what_the_stop_changes_too():
    """A layer of 3e-6 that it leaves out decides whether a pixel ends; the page's bound of the layer alone is less."""
    dense = float(np.float32(0.99))
    faint = (1.0, 1.0, 0.0, 0.5 + 5.04 * np.sqrt(1.3), 0.5, 1.0)
    layers = needles([OPAQUE, (*OPAQUE[:5], dense), faint, OPAQUE], [0.0, 0.0, 0.0, 1.0])
    rule = Definition(alpha_min=1e-9, stop=(1 - dense) ** 2 * (1 - 1e-6))
    ends, goes_on = (
        render_reference(layers, CORNER, definition=replace(rule, cut_radius=radius)).rgb.max() for radius in (6.0, 5.0)
    )
    assert ends == 0
    assert np.exp(-(5.0**2) / 2) < goes_on <= rule.stop * (1 + 2e-6)


def test_the_scenes_that_climbing_found():
    """Measured 2.9e-6 and 7.4e-5."""
    colour = compare(climbed(COLOUR_SCENE), CLIMBED, edges=EDGES)
    depth = compare(climbed(DEPTH_SCENE), CLIMBED, edges=EDGES)
    assert max(colour.smooth, depth.smooth) < COLOUR
    assert max(colour.depth, depth.depth) < LIGHT
    assert colour.on_edge == depth.on_edge == 0


@pytest.mark.parametrize("row", [ONE, ABOVE, BELOW, DENSE])
def test_one_needle_through_the_corner_of_a_tile(row):
    """Measured 3.3e-6, and 9.1e-5 of the light that the dense one leaves; an opacity is rounded by 6e-8 more."""
    needle = needles([row], [1.0])
    ours, true = (float(draw(needle, CORNER).alpha[0, 0]) for draw in (render, render_reference))
    distance = np.sqrt(-2 * np.log(true / np.float32(row[-1]).astype(float)))
    assert abs(ours - true) < (ALPHA * distance + ALPHA_LEAST) * true + 6e-8
    assert abs(ours - true) < SINGLE
    assert abs(ours - true) < LIGHT * (1 - true)


@pytest.mark.parametrize("pairs", [100, 300, 600, 1500])
def test_faint_edges_whose_errors_add_up(pairs):
    """White ones too strong and black ones too weak, in turn: measured 8.8e-6. All of one sign: 7.2e-6."""
    assert compare(needles([ABOVE, BELOW] * pairs, [1.0, 0.0] * pairs), CORNER, edges=EDGES).smooth < COLOUR
    assert compare(needles([ABOVE] * pairs, [1.0] * pairs), CORNER, edges=EDGES).smooth < COLOUR


@pytest.mark.parametrize(("opacity", "brightest"), [(0.00393, 1.0), (0.00393, 1.07), (0.02, 1.0)])
def test_layers_that_are_all_rounded_one_way(opacity, brightest):
    """Colours are chosen so that each layer rounds the colour so far up: measured 6.7e-5, 1.1e-4 and 1.3e-5 of R."""
    one = Gaussians.make([[0.0, 0, 1]], [[1.0, 1, 1]], [[1.0, 0, 0, 0]], [opacity], np.zeros((1, 1, 3)))
    view = Camera.make(1, 1, 1.0, 1.0, 0.5, 0.5, np.eye(4))
    alpha, light, colour = render(one, view, outputs=("peaks",)).peaks[0], np.float32(1), np.float32(0)
    constants = []
    while light > Definition().stop:
        weight = alpha * light
        colours = brightest - np.linspace(min(4e-7 / weight, 0.5 * brightest), 0, 4001)
        bands = ((colours - 0.5) / 0.28209479177387814).astype(np.float32)
        colours = (0.5 + 0.28209479177387814 * bands.astype(float)).astype(np.float32)
        exact = float(weight) * colours.astype(float) + float(colour)
        best = np.argmax(exact.astype(np.float32) - exact)
        constants.append(bands[best])
        colour, light = np.float32(exact[best]), light - weight
    count, z = len(constants), np.linspace(1, 2, len(constants))
    layers = Gaussians.make(
        np.outer(z, [0, 0, 1]),
        np.ones((count, 3)),
        np.tile([1.0, 0, 0, 0], (count, 1)),
        np.full(count, opacity),
        np.array(constants, float)[:, None, None] * np.ones((1, 1, 3)),
    )
    ours, true = render(layers, view), render_reference(layers, view)
    change = np.abs(ours.rgb - true.rgb).max() / brightest
    assert COLOUR < change < COLOUR + LAYER * count
    assert np.abs(ours.alpha - true.alpha).max() < COLOUR


@pytest.mark.parametrize("front", [[DENSE] * 2, [ABOVE] * 2330, [BELOW] * 2300, [DENSE] + [ABOVE] * 1150])
def test_a_depth_behind_what_lets_hardly_anything_through(front):
    """Measured 1.8e-4 behind the first two."""
    depths = np.append(1 + 1e-13 * np.arange(len(front)), 1e9)
    far = needles([*front, OPAQUE], [0.0] * len(depths), depths)
    assert render_reference(far, CORNER).depth[0, 0] > 1e4
    assert compare(far, CORNER, edges=EDGES).depth < LIGHT


def test_a_depth_behind_two_round_layers():
    """Measured 2.6e-5."""
    z = np.array([0.05, 0.051, 10215.900512417998])
    layers = Gaussians.make(
        np.outer(z, [0, 0, 1]),
        np.outer(10 * z, [1, 1, 1]),
        np.tile([1.0, 0, 0, 0], (3, 1)),
        [0.9895506501197815, 0.9898040890693665, 1.0],
        np.zeros((3, 1, 3)),
    )
    result = compare(layers, camera(9, 9, 9.0), edges=EDGES)
    assert 2e-5 < result.depth < LIGHT


@pytest.mark.case("E8")
def test_the_stop_flips_only_where_the_light_lies_near_it():
    """A second layer just off a pixel's centre leaves 1e-4 times 1 to 1 + 5e-5; what is farther off is drawn alike."""
    view, size, flipped = Camera.make(1, 1, 1.0, 1.0, 0.5, 0.5, np.eye(4)), 1e6, []
    for offset in np.linspace(0, 7e-3, 141):
        layers = Gaussians.make(
            [[0, 0, 1.0], [offset * size, 0, 1.1], [0, 0, 1.2]],
            np.full((3, 3), size),
            np.tile([1.0, 0, 0, 0], (3, 1)),
            [1.0, float(np.float32(0.99)), 1.0],
            np.eye(3)[:, None] * 3.0,
        )
        assert compare(layers, view, edges=EDGES).smooth < COLOUR
        narrow = compare(layers, view)
        flipped.append(narrow.on_edge == 0 and narrow.smooth > COLOUR)
    assert any(flipped)  # 1e-5 of the stop would be too little


@pytest.mark.case("E8")
@pytest.mark.parametrize("radius", [0.01, 0.03, 0.1, 0.5])
def test_a_radius_cuts_within_the_edge_in_squared_distance(radius):
    """Round layers whose distances from a pixel lie about the radius; 0.010044 is drawn where 0.01 cuts."""
    rule, sigma = Definition(cut_radius=radius), np.sqrt(100 + 0.3)
    edges = Edges(EDGES.alpha_min, EDGES.stop, min(SQUARED / radius**2, 0.999))
    flips = 0
    for share in np.linspace(-1.5, 1.5, 61):
        distance = np.sqrt(radius**2 + share * 1e-6)
        one = needles([(10.0, 10.0, 0.0, 0.5 + distance * sigma, 0.5, 0.0045)], [1.0])
        assert compare(one, CORNER, rule, edges).smooth < COLOUR
        flips += compare(one, CORNER, rule).smooth > COLOUR
    assert flips > 0 or radius > 0.1  # 1e-5 of the radius would be too little for small ones
