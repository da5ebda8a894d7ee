"""Which photographs foretell another one, and how a request, a command and a scene say so."""

import numpy as np
import pytest
from plane_scene import PlaneScene

from gapmes.service import cli
from gapmes.service.budget import KEEP_ALL
from gapmes.service.camera import Camera
from gapmes.service.errors import InputError
from gapmes.service.foretold import checked_others, nearest_others
from gapmes.service.reconstruct import Reconstructor
from gapmes.service.shipped import sample_folder


def _at(*places):
    cameras = []
    for place in places:
        pose = np.eye(4)
        pose[0, 3] = place
        cameras.append(Camera.make(64, 64, 64.0, 64.0, 32.0, 32.0, pose))
    return cameras


def test_the_nearest_cameras_in_their_own_order():
    cameras = _at(0.0, 5.0, 1.0, 2.5, 9.0)
    assert nearest_others(cameras, 0, 2) == [2, 3]
    assert nearest_others(cameras, 4, 3) == [1, 2, 3]
    assert nearest_others(cameras, 2, 5) == [0, 1, 3, 4]


def test_of_equally_near_ones_the_first():
    assert nearest_others(_at(0.0, 1.0, -1.0, 1.0), 0, 2) == [1, 2]


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
    assert [row["from"] for row in rows] == [nearest_others(scene.cameras, index, 2) for index in range(views)]
    wide = reconstructor.reconstruct(scene.images, scene.cameras, leave_one_out=views - 1, **given).document
    every = [[other for other in range(views) if other != index] for index in range(views)]
    assert [row["from"] for row in wide["check"]["leave_one_out"]] == every
    assert rows != wide["check"]["leave_one_out"]


def test_the_command_says_so_before_it_loads_anything(tmp_path, capfd):
    arguments = ["reconstruct", str(sample_folder()), "-o", str(tmp_path / "x.ply"), "--leave-one-out", "1"]
    with pytest.raises(SystemExit) as end:
        cli.main(arguments)
    assert end.value.code == 1
    error = capfd.readouterr().err
    assert "leave_one_out: is 1, need 2 to 5" in error
    assert "load model" not in error
