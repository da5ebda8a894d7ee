"""The self-check of a reconstruction: figures against closed forms and another SSIM, shares against known cases."""

import math
from dataclasses import replace

import numpy as np
import pytest
from skimage.metrics import structural_similarity

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.depth_range import DepthRange
from gapmes.service.commands.summary import check_line, left_out_lines
from gapmes.service.gaussians import Gaussians
from gapmes.service.photographs.images import FittedView
from gapmes.service.pictures.picture_error import psnr, ssim
from gapmes.service.self_check import GRID, ambiguous_routes, depth_steps, from_others, has_parallax, self_check
from gapmes.service.splat import render

DEPTHS = DepthRange(1.0, 10.0, "given")


class Info:
    """The field of `ModelInfo` that is looked at."""

    depth_planes = 65


def camera(x: float = 0.0, turn: float = 0.0, size: int = 48) -> Camera:
    pose = np.eye(4)
    c, s = np.cos(turn), np.sin(turn)
    pose[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    pose[0, 3] = x
    return Camera.make(size, size, 50.0, 50.0, size / 2, size / 2, pose)


def cloud(seed: int = 0) -> Gaussians:
    rng = np.random.default_rng(seed)
    means = np.column_stack([rng.uniform(-1.5, 1.5, (400, 2)), rng.uniform(2, 3, 400)])
    harmonics = rng.uniform(-1.7, 1.7, (400, 1, 3))
    return Gaussians.make(means, np.full((400, 3), 0.15), rng.standard_normal((400, 4)), np.full(400, 0.9), harmonics)


def drawn(gaussians: Gaussians, view: Camera, mask: np.ndarray | None = None) -> FittedView:
    picture = np.clip(render(gaussians, view, near=0.1).rgb, 0, 1).transpose(2, 0, 1)
    return FittedView(np.ascontiguousarray(picture), mask, view, 1.0)


def checked(gaussians: Gaussians, fitted: list[FittedView]) -> dict:
    pictures = [render(gaussians, view.camera, near=0.1, outputs=("alpha",)) for view in fitted]
    return self_check(fitted, DEPTHS, Info, pictures, fitted)


@pytest.mark.parametrize("seed", range(3))
def test_ssim_is_that_of_scikit_image(seed):
    rng = np.random.default_rng(seed)
    truth = rng.random((3, 40, 52)).cumsum(axis=2) / 52
    picture = np.clip(truth + rng.normal(0, 0.05, truth.shape), 0, 1)
    _, expected = structural_similarity(
        picture, truth, channel_axis=0, data_range=1.0, gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
        win_size=11, full=True,
    )  # fmt: skip
    assert ssim(picture, truth) == pytest.approx(expected[:, 5:-5, 5:-5].mean(), abs=1e-9)
    narrow = ssim(picture.astype(np.float32), truth.astype(np.float32))
    assert narrow == pytest.approx(ssim(picture, truth), abs=2e-6)  # measured 1.0e-7 at 256 px
    mask = rng.random((40, 52)) < 0.3
    inner = mask[5:-5, 5:-5]
    assert ssim(picture, truth, mask) == pytest.approx(expected[:, 5:-5, 5:-5].mean(axis=0)[inner].mean(), abs=1e-9)


def test_psnr_has_a_closed_form_and_ends_at_100_db():
    truth = np.full((3, 12, 12), 0.5, np.float32)
    picture = truth.copy()
    picture[:, :6] += np.float32(0.125)
    top = np.arange(12)[:, None] < np.full(12, 6)
    assert psnr(picture, truth) == pytest.approx(-10 * math.log10(0.125**2 / 2))
    assert math.isnan(psnr(picture + np.nan, truth))
    assert psnr(picture, truth, top) == pytest.approx(-10 * math.log10(0.125**2))
    assert psnr(picture, truth, ~top) == 100.0
    assert ssim(truth, truth) == pytest.approx(1.0)
    white = np.ones((3, 16, 16), np.float32)
    for grey in (1.0, 254 / 255, 253 / 255):  # nothing but brightness differs, and nothing of that is rounding
        light = 2 * grey / (grey**2 + 1)
        assert ssim(white * np.float32(grey), white) == pytest.approx(light, abs=1e-6)
    black = np.zeros((4, 4, 3), np.uint8)
    assert psnr(black, black + 255) == pytest.approx(0.0)
    assert psnr(black, black + 51) == pytest.approx(-20 * math.log10(0.2))
    assert math.isnan(psnr(picture, truth, np.zeros((12, 12), bool)))
    assert math.isnan(ssim(picture[:, :8], truth[:, :8]))


def test_a_scene_that_shows_its_inputs_says_so_and_another_does_not():
    gaussians, views = cloud(), [camera(), camera(0.3)]
    fitted = [drawn(gaussians, view) for view in views]
    check = checked(gaussians, fitted)
    assert [row["psnr"] for row in check["input_views"]] == [100.0, 100.0]
    assert [row["ssim"] for row in check["input_views"]] == [1.0, 1.0]
    other = checked(cloud(1), fitted)
    assert max(row["psnr"] for row in other["input_views"]) < 20
    nothing = checked(gaussians[:0], fitted)
    assert [row["holes"] for row in nothing["input_views"]] == [1.0, 1.0]


def test_only_what_the_mask_keeps_counts():
    gaussians, view = cloud(), camera()
    half = np.broadcast_to(np.arange(48) < 24, (48, 48))
    spoiled = drawn(gaussians, view, half)
    spoiled.image[:, :, 24:] = 0.5
    fitted = [spoiled, drawn(gaussians, camera(0.3), np.zeros((48, 48), bool))]
    check = checked(gaussians, fitted)
    assert check["input_views"][0]["psnr"] == 100.0
    assert check["input_views"][1] == {"psnr": None, "ssim": None, "holes": None}
    whole = checked(gaussians, [replace(spoiled, mask=None)])
    assert whole["input_views"][0]["psnr"] < 40
    assert whole["textureless_share"] == pytest.approx((48 - 24 - 3) / 48, abs=0.01)  # windows of 7 px within the grey


@pytest.mark.case("P2")
def test_parallax_is_a_shift_between_near_and_far():
    """A sideways step b shifts by f b (1/near - 1/far) px: 45 b here."""
    views = [FittedView(np.zeros((3, 48, 48), np.float32), None, camera(x), 1.0) for x in (0.0, 0.0, 0.0)]
    assert not has_parallax(views, 0, DEPTHS).any()
    for shift, expected in ((0.24, 0.0), (0.26, 1.0)):
        views[1] = replace(views[1], camera=camera(shift / 45))
        assert has_parallax(views[:2], 0, DEPTHS).mean() == pytest.approx(expected, abs=1 / GRID)
    turned = [views[0], replace(views[1], camera=camera(0.0, 0.4))]
    assert not has_parallax(turned, 0, DEPTHS).any()  # a pure rotation moves the picture, not its depths
    away = [views[0], replace(views[1], camera=camera(0.5, math.pi))]
    assert not has_parallax(away, 0, DEPTHS).any()


@pytest.mark.case("P1", "P3")
def test_depth_steps_are_half_the_distance_of_candidates():
    candidates = 1 / np.linspace(1 / DEPTHS.near, 1 / DEPTHS.far, 65)
    steps = depth_steps(DEPTHS, Info)
    half_way = 2 / (1 / candidates[:-1] + 1 / candidates[1:])  # between two candidates in inverse depth
    assert steps["far"] == pytest.approx((10 - half_way[-1]) / 10, abs=1e-6)
    assert steps["near"] == pytest.approx(0.9 / 128 / (1 + 0.9 / 128), abs=1e-6)
    assert steps["middle"] == pytest.approx(1 - 1 / (1 + math.sqrt(10) * 0.9 / 128), abs=1e-6)
    wide = depth_steps(DepthRange(1.0, 1e6, "given"), Info)
    assert 0.99 < (wide["far"] or 0.0) < 1  # half a step before 1e6 is nearly all of it, never more
    assert depth_steps(DEPTHS, type("Other", (), {"depth_planes": None}))["far"] is None


@pytest.mark.case("P8")
def test_a_uniform_object_on_a_mask_has_no_texture():
    mask = np.zeros((48, 48), bool)
    mask[20:30, 15:25] = True
    image = np.where(mask, np.float32(0.6), np.float32(0.0)) * np.ones((3, 1, 1), np.float32)
    views = [FittedView(image, mask, camera(x), 1.0) for x in (0.0, 0.3)]
    assert checked(cloud(), views)["textureless_share"] == 1.0


@pytest.mark.case("P8")
@pytest.mark.parametrize(("levels", "flat"), [(1.99, 1.0), (2.01, 0.0)])
def test_texture_begins_at_a_standard_deviation_of_two_levels(levels, flat):
    """A checkerboard of single pixels deviates by its amplitude, by 0.02 % less in windows of 25 and 24 of them."""
    grey = 0.5 + levels / 255 * (np.indices((48, 48)).sum(axis=0) % 2 * 2 - 1)
    image = (grey * np.ones((3, 1, 1))).astype(np.float32)
    views = [FittedView(image, None, camera(x), 1.0) for x in (0.0, 0.3)]
    assert checked(cloud(), views)["textureless_share"] == flat


def test_rays_that_cross_a_picture_quickly_are_found():
    """A long step to the side, turned inwards: each ray is in the other picture for a small part of its depths."""
    views = [FittedView(np.zeros((3, 48, 48), np.float32), None, view, 1.0) for view in (camera(), camera(1.0, -0.3))]
    found = has_parallax(views, 0, DepthRange(0.05, 100.0, "given"))
    assert found.mean() > 0.95


def test_the_line_of_the_command_names_what_is_known():
    gaussians = cloud()
    check = checked(gaussians, [drawn(gaussians, camera(x)) for x in (0.0, 0.3)])
    line = check_line(check)
    assert line.startswith("inputs drawn again: 100.0, 100.0 dB; ")
    assert line.endswith("depth candidates every 4.4 % half way")
    check["depth_step"]["middle"], check["no_parallax_share"] = None, None
    check["input_views"][1]["psnr"] = None
    assert "100.0, no pixel dB" in check_line(check)
    assert "parallax" not in check_line(check)
    check["from_others"] = [{"psnr": 20.04}, {"psnr": None}]
    check["leave_one_out"] = [{"psnr": 18.0}, {"psnr": 19.0}]
    check["ambiguous_routes"] = 0.0125
    foretold = "drawn from the other views: 20.0, no pixel dB; predicted by others: 18.0, 19.0 dB"
    assert f"{foretold}; 1.25 % ambiguous routes; " in check_line(check) + "; "


def test_an_input_is_drawn_from_the_others_alone():
    """Three clouds in the same place: where a view's own is spoiled, the others still show what it saw."""
    gaussians, cameras = cloud(), [camera(), camera(0.2), camera(0.4)]
    fitted = [drawn(gaussians, view) for view in cameras]
    assert from_others(gaussians, np.zeros(400, int), fitted[:2], near=0.1) is None
    three = Gaussians.make(
        *(np.concatenate([getattr(gaussians, name)] * 4) for name in
          ("means", "scales", "rotations_wxyz", "opacities", "harmonics"))
    )  # fmt: skip
    owner = np.repeat([0, 1, 2, 3], 400)  # the last belong to no view's pixels
    three.harmonics[owner == 1] = -1.0
    three.harmonics[owner == 3] = 1.5
    rows = from_others(three, owner, fitted, near=0.1)
    assert rows[1]["psnr"] > 3 + max(rows[0]["psnr"], rows[2]["psnr"])
    alone = from_others(gaussians, np.full(400, 1), fitted, near=0.1)
    assert alone[1] == {"psnr": None, "ssim": None, "holes": 1.0}
    assert alone[0]["holes"] == checked(gaussians, fitted)["input_views"][0]["holes"]


@pytest.mark.case("R2")
def test_routes_that_rounding_may_decide_are_counted_among_the_kept_patches():
    margin = np.array([[0.0, 1e-5, 3e-4, 1e-3], [0.5, 1e-6, 1.0, 1.0]], np.float32)
    everything = np.ones((2, 4), bool)
    assert ambiguous_routes({"route_margin": margin}, everything) == 0.5
    assert ambiguous_routes({"route_margin": margin}, np.arange(8).reshape(2, 4) > 2) == 0.2
    assert ambiguous_routes({"route_margin": margin}, ~everything) is None
    assert ambiguous_routes({}, everything) is None


def test_the_table_of_what_was_left_out():
    document = {"left_out": [], "pruning": {"dropped": 0}}
    assert left_out_lines(document) == ["left out: nothing"]
    document["left_out"] = [
        {"what": "Gaussians", "count": 1200, "of": 9000, "error": 0.0037},
        {"what": "experts", "count": 1, "of": 6, "error": 0.0},
    ]
    assert left_out_lines(document)[1].split() == ["Gaussians", "1,200", "9,000", "at", "most", "0.00370"]
    assert left_out_lines(document)[2].endswith("none")
    document["pruning"] = {
        "dropped": 1200, "certified": {"inputs": 2, "between": 3, "asked": 1}, "actual": 0.001, "bytes_saved": 81600,
        "picture_seconds": [0.0125, 0.011], "seconds": 0.25,
    }  # fmt: skip
    text = "\n".join(left_out_lines(document))
    assert "2 inputs, 3 views between them and 1 asked for, 0.00100 found" in text
    assert "saved 82 kB of .ply; a picture takes 11.0 ms, all of it would take 12.5 ms; deciding took 0.25 s" in text
