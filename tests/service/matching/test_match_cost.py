"""Costs of depths: zero where photographs agree, the limit where nothing is seen, aggregated over known pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from plane_views import SIDE, plane_depths

from gapmes.service.matching.correspondence import reprojected
from gapmes.service.matching.match_cost import GRADIENT, LIMIT, CostAggregation, difference, features
from gapmes.service.photographs.images import FittedView


def test_features_are_colours_and_slopes(views: list[FittedView]) -> None:
    ramp = np.broadcast_to(np.linspace(0, 1, SIDE, dtype=np.float32), (3, SIDE, SIDE))
    found = features(replace(views[0], image=ramp))
    assert (found[..., :3] == ramp.transpose(1, 2, 0)).all()
    assert np.abs(found[1:-1, 1:-1, 3] - GRADIENT / (SIDE - 1)).max() < 1e-6
    assert (found[..., 4] == 0).all()
    assert (found[:, [0, -1], 3] == 0).all()  # the border has no neighbour


def test_a_slope_beside_a_masked_pixel_is_none(views: list[FittedView]) -> None:
    mask = np.ones((SIDE, SIDE), bool)
    mask[20, 30] = False
    found = features(replace(views[0], mask=mask))
    assert (found[20, [29, 31], 3] == 0).all()
    assert (found[[19, 21], 30, 4] == 0).all()
    assert (found[20, 40, 3:] != 0).any()


def test_the_right_depth_costs_least(views: list[FittedView]) -> None:
    depth = plane_depths(views)[0]
    own, others = features(views[0]), features(views[1])
    right, wrong = (difference(views[0], own, k * depth, views[1], others) for k in (1.0, 1.1))
    both = reprojected(views[0], depth, views[1]).where & reprojected(views[0], 1.1 * depth, views[1]).where
    assert both.mean() > 0.5
    assert np.median(right[both]) < 0.3 * np.median(wrong[both])  # found: 0.14
    assert (wrong <= LIMIT).all()


def test_what_is_not_seen_costs_the_limit(views: list[FittedView]) -> None:
    depth = plane_depths(views)[0]
    cost = difference(views[0], features(views[0]), depth, views[1], features(views[1]))
    hidden = ~reprojected(views[0], depth, views[1]).where
    assert hidden.any()
    assert (cost[hidden] == LIMIT).all()


def test_unknown_costs_do_not_count(views: list[FittedView]) -> None:
    """Where all that is known costs the same, so does everything near it."""
    known = np.random.default_rng(2).random((SIDE, SIDE)) < 0.8
    found = CostAggregation(views[0], known).of(np.where(known, 0.1, 0.0))
    assert np.abs(found[known] - 0.1).max() < 1e-9
