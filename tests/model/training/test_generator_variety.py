"""The variety of the generator: every camera motion, every kind of place, surface and background."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gapmes.model.training import camera_paths
from gapmes.model.training.camera_paths import STYLE_SHARES, STYLES, WIDEST_ORBIT, camera_poses
from gapmes.model.training.layouts import make_world
from gapmes.model.training.objects import Paint
from gapmes.model.training.primitives import BOX, CYLINDER, ELLIPSOID, ROOM
from gapmes.model.training.textures import load_atlas


def test_an_orbit_turns_by_40_degrees_at_most_about_its_middle() -> None:
    rng, along = np.random.default_rng(0), np.linspace(-0.5, 0.5, 5)
    turned = []
    for baseline in (0.1, 0.4, 0.8, 3.0):
        for _ in range(50):
            centres, aim = camera_paths._orbit(rng, along, baseline, 1.0)
            radius = aim[2]
            # cameras turn about a vertical axis, which is then tilted about z: both leave z alone
            turned.append(2 * math.acos(float(1 - centres[0, 2] / radius)))
            assert centres[:, 2] == pytest.approx(radius * (1 - np.cos(np.linspace(-0.5, 0.5, 5) * turned[-1])))
    assert max(turned) == pytest.approx(WIDEST_ORBIT)
    assert min(turned) < 0.2 * WIDEST_ORBIT


def test_all_three_motions_are_drawn_in_their_shares(monkeypatch: pytest.MonkeyPatch) -> None:
    """By their effect: an orbit has its arc; the others go mainly ahead or mainly aside."""
    orbits = []
    real = camera_paths._orbit
    monkeypatch.setattr(camera_paths, "_orbit", lambda *a: orbits.append(1) or real(*a))
    rng, count, ahead = np.random.default_rng(1), 2000, 0
    for _ in range(count):
        before = len(orbits)
        poses = camera_poses(rng, 2, 1, 0.4, 1.0, 0.5)
        way = np.abs(poses[1, :3, 3] - poses[0, :3, 3])
        ahead += len(orbits) == before and way[2] > max(way[0], way[1])
    shares = dict(zip(STYLES, STYLE_SHARES, strict=True))
    assert len(orbits) / count == pytest.approx(shares["orbit"], abs=0.04)
    # of "sideways" some go ahead too, of "forward" some do not: measured 0.27
    assert ahead / count == pytest.approx(shares["forward"], abs=0.06)


@pytest.mark.parametrize("baseline", [0.1, 1.0, 2.0])
def test_however_far_apart_cameras_look_at_what_is_between_them(
    monkeypatch: pytest.MonkeyPatch, baseline: float
) -> None:
    """On wide baselines they are turned inwards: the middle of the scene stays in the pictures of first and last."""
    monkeypatch.setattr(camera_paths, "STYLES", ("sideways",) * 3)
    rng, seen, half_width = np.random.default_rng(5), [], 0.5
    for _ in range(300):
        for pose in camera_poses(rng, 2, 1, baseline, 1.0, half_width)[:2]:
            x, _, z = pose[:3, :3].T @ (np.array([0.0, 0.0, 1.0]) - pose[:3, 3])
            seen.append(z > 0 and abs(x / z) < half_width)
    assert np.mean(seen) > 0.95  # measured 0.978 at 2; 0.73 without


@pytest.mark.parametrize(("aside", "median", "farthest"), [(0.0, 0.09, 0.6), (0.4, 0.22, 2.4)])
def test_targets_lie_off_the_way_between_the_inputs_as_far_as_asked(
    aside: float, median: float, farthest: float
) -> None:
    """Distance from the line through both inputs, in units of their distance."""
    rng, off = np.random.default_rng(3), []
    for _ in range(1500):
        first, last, *targets = camera_poses(rng, 2, 2, 0.3, 1.0, 0.5, aside)[:, :3, 3]
        way = (last - first) / np.linalg.norm(last - first)
        off += [np.linalg.norm(np.cross(target - first, way)) / 0.3 for target in targets]
    assert np.median(off) == pytest.approx(median, abs=0.03)  # measured 0.094 and 0.219
    assert farthest / 3 < max(off) < farthest
    assert np.quantile(off, 0.1) < 0.1  # many stay on it


def test_worlds_have_what_is_promised() -> None:
    """Over 300 worlds, without tracing a ray."""
    rng, atlas = np.random.default_rng(2), load_atlas()
    worlds = [make_world(rng, Paint.of(rng, atlas, "train"), 0.5) for _ in range(300)]
    for kind in (BOX, ELLIPSOID, CYLINDER):
        assert np.mean([any(item.kind == kind for item in world.primitives) for world in worlds]) > 0.5
    assert np.mean([world.primitives[0].kind == ROOM for world in worlds]) == pytest.approx(0.45, abs=0.08)
    solids = [item for world in worlds for item in world.primitives if item.kind != ROOM]
    assert 0.1 < np.mean([item.gloss > 0 for item in solids]) < 0.3
    assert np.mean([item.half.max() / np.sort(item.half)[1] > 5 for item in solids]) > 0.05  # rods and legs
    untextured = np.mean([atlas.flat[item.textures].all() for item in solids])
    assert 0.05 < untextured < 0.5
    assert 0.2 < np.mean([world.light.shadows for world in worlds]) < 0.95
    sky = [world.background for world in worlds if world.background.low.tolist() != world.background.high.tolist()]
    assert 0.1 < len(sky) / len(worlds) < 0.4
    alone = [float(world.background.low[0]) for world in worlds if world.primitives[0].kind != ROOM]
    assert 0.0 in alone
    assert 1.0 in alone
