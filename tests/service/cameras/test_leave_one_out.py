"""Predicting each photograph from others: the choice of the others, and the options and results of it."""

from itertools import permutations

import numpy as np
import pytest
from plane_scene import PlaneScene

from gapmes.service import cli
from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.depth_range import DepthRange
from gapmes.service.cameras.leave_one_out import checked_others, nearest_others
from gapmes.service.cameras.rotations import about_axis
from gapmes.service.cameras.view_checks import MIN_PARALLAX_PX, check_views
from gapmes.service.commands.summary import check_line
from gapmes.service.errors import BaselineError, InputError
from gapmes.service.leaving_out.budget import KEEP_ALL
from gapmes.service.reconstruct import Reconstructor
from gapmes.service.shipped import sample_folder

NEAR = 2.0


def _at(*places, turns=None):
    """Cameras at x that look along z, except for their rotation about y."""
    cameras = []
    for place, turn in zip(places, turns or [0.0] * len(places), strict=True):
        pose = np.eye(4)
        pose[0, 3] = place
        pose[:3, :3] = about_axis(np.array([0.0, 1.0, 0.0]), turn)
        cameras.append(Camera.make(64, 64, 64.0, 64.0, 32.0, 32.0, pose))
    return cameras


def test_the_nearest_cameras_in_their_own_order():
    cameras = _at(0.0, 5.0, 1.0, 2.5, 9.0)
    assert nearest_others(cameras, 0, 2, NEAR) == [2, 3]
    assert nearest_others(cameras, 4, 3, NEAR) == [1, 2, 3]
    assert nearest_others(cameras, 2, 5, NEAR) == [0, 1, 3, 4]


def test_of_equally_near_ones_the_left_one_also_where_rounding_says_otherwise():
    assert nearest_others(_at(0.0, 1.0 - 1e-9, -1.0, 3.0, 0.5), 0, 2, NEAR) == [2, 4]
    backwards = _at(0.0, 1.0, -1.0 + 1e-9, 3.0, 0.5, turns=[np.pi, 0, 0, 0, 0])  # its left is the world's right
    assert nearest_others(backwards, 0, 2, NEAR) == [1, 4]


@pytest.mark.parametrize("count", [2, 3])
def test_the_order_of_the_photographs_does_not_decide(count):
    cameras = _at(0.0, 0.0, 2.0, 4.0, 6.0, turns=[0.0, 1e-3, 0.1, 0.0, -0.1])
    for camera in cameras:
        answers = set()
        for order in permutations(cameras):
            chosen = nearest_others(order, order.index(camera), count, NEAR)
            answers.add(frozenset(cameras.index(order[other]) for other in chosen))
        assert len(answers) == 1


@pytest.mark.parametrize("apart", [0.0, 0.99, 1.01])
def test_two_in_one_place_foretell_nothing_alone(apart):
    """The second is replaced if a point at near shifts by less than a quarter pixel between both."""
    apart *= MIN_PARALLAX_PX * NEAR / 64.0
    cameras = _at(0.0, -apart, 2.0, 4.5, 9.0, turns=[0.0, 1e-3, 0.0, 0.0, 0.0])
    chosen = nearest_others(cameras, 2, 2, NEAR)
    if apart > MIN_PARALLAX_PX * NEAR / 64.0:
        assert chosen == [0, 1]
    else:
        assert chosen[0] in (0, 1)
        assert chosen[1] == 3
        with pytest.raises(BaselineError, match="no pair of views has parallax"):
            check_views(cameras[:2], DepthRange(NEAR, 8.0, "given"))
    assert nearest_others(cameras, 2, 3, NEAR) == [0, 1, 3]
    assert nearest_others(cameras, 0, 2, NEAR) == [1, 2]


def test_where_no_others_have_parallax_there_are_none():
    cameras = _at(0.0, 0.0, 2.0, turns=[0.0, 1e-3, 0.0])
    assert [nearest_others(cameras, index, 2, NEAR) for index in range(3)] == [[1, 2], [0, 2], []]


@pytest.mark.parametrize("count", [0, 2, 3, 4, 5])
def test_numbers_that_leave_one_of_some_set_out(count):
    assert checked_others(count) == count


@pytest.mark.parametrize("count", [1, 6, -1, True, 2.0])
def test_other_numbers_are_refused(count):
    with pytest.raises(InputError, match="need 2 to 5 views"):
        checked_others(count)


@pytest.mark.parametrize("views", [4, 5])
def test_of_four_and_more_the_nearest_foretell_each(engine, views):
    """Cameras side by side: the two nearest; more where more are asked for."""
    scene = PlaneScene.make(np.random.default_rng(7), count=views, turn=0.5)
    reconstructor = Reconstructor(engine)
    given = {"near": 2.0, "far": 8.0, "budget": KEEP_ALL}
    document = reconstructor.reconstruct(scene.images, scene.cameras, **given).document
    rows = document["check"]["leave_one_out"]
    nearest = [nearest_others(scene.cameras, index, 2, 2.0) for index in range(views)]
    assert [row["from"] for row in rows] == nearest
    wide = reconstructor.reconstruct(scene.images, scene.cameras, leave_one_out=views - 1, **given).document
    every = [[other for other in range(views) if other != index] for index in range(views)]
    assert [row["from"] for row in wide["check"]["leave_one_out"]] == every
    assert rows != wide["check"]["leave_one_out"]


def test_a_view_that_the_others_cannot_foretell_has_no_figure_and_a_warning(engine):
    """Two of three photographs from one place."""
    scene = PlaneScene.make(np.random.default_rng(7), count=2, turn=0.5)
    first, second = scene.cameras
    turned = first.world_from_cam.copy()
    turned[:3, :3] = turned[:3, :3] @ about_axis(np.array([0.0, 1.0, 0.0]), 1e-3)
    again = scene.images[0] ^ np.uint8(1)  # not the same photograph twice
    views = [scene.images[0], again, scene.images[1]], [first, first.posed(turned), second]
    document = (
        Reconstructor(engine)
        .reconstruct(*views, near=2.0, far=8.0, budget=KEEP_ALL, trust_poses=True, numbers=[3, 5, 8])
        .document
    )
    rows = document["check"]["leave_one_out"]
    assert [row["from"] for row in rows] == [[1, 2], [0, 2], []]
    assert rows[2] == {"from": [], "psnr": None, "ssim": None, "holes": None}
    assert all(row["psnr"] > 10 for row in rows[:2])
    (warning,) = [warning for warning in document["warnings"] if warning["code"] == "not_foretold"]
    assert (warning["field"], warning["index"]) == ("cameras", 8)
    assert "view 8 is not foretold" in warning["message"]
    assert "near = 2 by 0 px, need at least 0.25" in warning["message"]
    assert f"predicted by others: {rows[0]['psnr']:.1f}, {rows[1]['psnr']:.1f}, no parallax dB" in check_line(
        document["check"]
    )


def test_the_command_says_so_before_it_loads_anything(tmp_path, capfd):
    arguments = ["reconstruct", str(sample_folder()), "-o", str(tmp_path / "x.ply"), "--leave-one-out", "1"]
    with pytest.raises(SystemExit) as end:
        cli.main(arguments)
    assert end.value.code == 1
    error = capfd.readouterr().err
    assert "leave_one_out: is 1, need 2 to 5" in error
    assert "load model" not in error
