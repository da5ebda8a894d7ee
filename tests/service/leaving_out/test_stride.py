"""One Gaussian per square of pixels, and leaving out faint ones: which stay, their size, and the change."""

import clouds
import numpy as np
import pytest
from plane_scene import PlaneScene
from standin_model import EXTRA, HEIGHT, WIDTH

from gapmes.service.errors import InputError
from gapmes.service.formats.ply_write import ply_size
from gapmes.service.leaving_out.budget import Budget
from gapmes.service.leaving_out.certified import certified_views
from gapmes.service.leaving_out.left_out import leave_out
from gapmes.service.leaving_out.pruning import prune
from gapmes.service.leaving_out.stride import thinned
from gapmes.service.photographs.masks import FADED, REPLACED
from gapmes.service.reconstruct import Reconstructor
from gapmes.service.splat import render
from gapmes.service.viewpoints.scene_views import SceneViews


def outputs(shape, extra=5, seed=0):
    rng = np.random.default_rng(seed)
    count = np.prod(shape) + extra
    return {
        "means": rng.random((count, 3), np.float32),
        "scales": rng.random((count, 3), np.float32),
        "harmonics": rng.random((count, 4, 3), np.float32),
    }


@pytest.mark.parametrize("stride", [2, 4])
def test_the_middle_of_each_square_stays_larger_and_of_the_mean_colour(stride):
    shape = views, height, width = 3, 8, 12
    full = outputs(shape)
    pixels = views * height * width
    rows = np.delete(np.arange(pixels + 5), [0, 7, pixels + 1])  # some were masked before
    thin, kept = thinned(full, rows, shape, stride)
    expected = []
    for view in range(views):
        for y in range(stride // 2, height, stride):
            for x in range(stride // 2, width, stride):
                row = (view * height + y) * width + x
                if row not in rows:
                    continue
                expected.append(row)
                square = [
                    (view * height + y + dy) * width + x + dx
                    for dy in range(-(stride // 2), stride // 2)
                    for dx in range(-(stride // 2), stride // 2)
                ]
                there = np.intersect1d(square, rows)
                np.testing.assert_allclose(thin["harmonics"][row], full["harmonics"][there].mean(axis=0), atol=1e-6)
                np.testing.assert_array_equal(thin["scales"][row], full["scales"][row] * stride)
    behind = [pixels, pixels + 2, pixels + 3, pixels + 4]
    assert kept.tolist() == expected + behind
    np.testing.assert_array_equal(thin["scales"][behind], full["scales"][behind])
    assert thin["means"] is full["means"]


@pytest.mark.parametrize("stride", [2, 4])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_where_the_middle_is_masked_the_kept_pixel_nearest_to_it_stays(stride, share):
    shape = views, height, width = 2, 16, 24
    full, pixels = outputs(shape), views * height * width
    kept = np.random.default_rng(3).random(shape) < share
    rows = np.concatenate([np.flatnonzero(kept), pixels + np.arange(5)])
    thin, chosen = thinned(full, rows, shape, stride)
    middle, expected = (stride - 1) / 2, []
    for view, top, left in np.ndindex(views, height // stride, width // stride):
        square = np.argwhere(kept[view, top * stride :, left * stride :][:stride, :stride]).tolist()
        if not square:
            continue
        y, x = min(square, key=lambda at: ((at[0] - middle) ** 2 + (at[1] - middle) ** 2, -at[0], -at[1]))
        expected.append((view * height + top * stride + y) * width + left * stride + x)
        there = [(view * height + top * stride + y) * width + left * stride + x for y, x in square]
        np.testing.assert_allclose(thin["harmonics"][expected[-1]], full["harmonics"][there].mean(axis=0), atol=1e-6)
    assert chosen.tolist() == [*sorted(expected), *range(pixels, pixels + 5)]
    np.testing.assert_array_equal(thin["scales"][expected], full["scales"][expected] * np.float32(stride))


def test_a_stride_of_one_is_the_scene_itself():
    full = outputs((2, 4, 4))
    thin, rows = thinned(full, np.arange(37), (2, 4, 4), 1)
    assert rows.tolist() == list(range(37))
    assert all(thin[name] is full[name] for name in full)


def test_a_reconstruction_with_a_stride(engine, plane_scene):
    given = {"near": plane_scene.near, "far": plane_scene.far, "fade": 0}
    reconstructor, photos, cameras = Reconstructor(engine), plane_scene.images, plane_scene.cameras
    whole = reconstructor.reconstruct(photos, cameras, budget=Budget(None), **given)
    thin = reconstructor.reconstruct(photos, cameras, budget=Budget(None, stride=2), **given)
    assert len(whole.gaussians) == 3 * (HEIGHT * WIDTH + EXTRA)
    assert len(thin.gaussians) == 3 * (HEIGHT * WIDTH // 4 + EXTRA)
    assert thin.document["pruning"]["stride"] == 2
    (row,) = [row for row in thin.document["left_out"] if row["what"] == "Gaussians between strides"]
    assert (row["count"], row["of"], row["error"]) == (3 * HEIGHT * WIDTH * 3 // 4, len(whole.gaussians), None)
    # What fades altogether is counted apart.
    faded = reconstructor.reconstruct(photos, cameras, budget=Budget(None, stride=2), **{**given, "fade": 8})
    rows = {row["what"]: row["count"] for row in faded.document["left_out"]}
    gone = rows[f"Gaussians: {FADED}"]
    added = faded.document["gaussians"]["added"] - rows[f"Gaussians: {REPLACED}"]
    assert gone == faded.document["fading"]["gone"] == len(thin.gaussians) + added - len(faded.gaussians) > 0
    assert rows["Gaussians between strides"] == row["count"]


def test_a_mask_of_every_fourth_row_leaves_a_scene(engine):
    """None of the kept pixels is in the middle of its square."""
    scene = PlaneScene.make(np.random.default_rng(7), count=2, size=(WIDTH, HEIGHT))
    alpha = np.zeros((HEIGHT, WIDTH, 1), np.uint8)
    alpha[::4] = 255
    photos = [np.concatenate([image, alpha], axis=2) for image in scene.images]
    given = {"near": scene.near, "far": scene.far, "fade": 0, "trust_poses": True}
    thin = Reconstructor(engine).reconstruct(photos, scene.cameras, budget=Budget(None, stride=4), **given)
    squares = 2 * HEIGHT * WIDTH // 16
    assert squares <= len(thin.gaussians) <= squares + 2 * EXTRA


@pytest.mark.parametrize("min_opacity", [0.05, 0.3, 0.95])
def test_faint_gaussians_go_and_the_change_is_bounded(min_opacity):
    gaussians, cameras = clouds.cloud(300, 4, degree=1), [clouds.view(-0.1), clouds.view(0.1)]
    gaussians.opacities[7] = min_opacity  # is not fainter
    scene = SceneViews(cameras)
    lean, pictures, report = leave_out(
        gaussians, np.ones(300, bool), scene, Budget(None, certify=2, min_opacity=min_opacity), 1
    )
    assert report["faint"] == int((gaussians.opacities < min_opacity).sum()) == 300 - len(lean)
    assert report["certified"] == {"inputs": 2, "between": 2, "asked": 0}
    assert (lean.opacities >= min_opacity).all()
    assert 0 < report["actual"] <= report["faint_bound"] == report["bound"]
    assert report["bytes_saved"] == ply_size(gaussians) - ply_size(lean) > 0
    for camera, picture in zip(cameras, pictures, strict=True):
        before, after = render(gaussians, camera), render(lean, camera)
        assert after.rgb.tobytes() == picture.rgb.tobytes()
        assert np.abs(before.rgb - after.rgb).max() <= report["faint_bound"]
    asked = Budget(None, asked=("orbit:20",), min_opacity=min_opacity)
    certified = leave_out(gaussians, np.ones(300, bool), scene, asked, 1)[2]["certified"]
    assert certified == {"inputs": 2, "between": 1, "asked": 1}
    assert leave_out(gaussians, np.ones(300, bool), scene, Budget(None), 1)[2]["faint"] == 0
    assert leave_out(gaussians, np.zeros(300, bool), scene, Budget(None, min_opacity=1.0), 1)[2]["faint"] == 0
    both = leave_out(gaussians, np.ones(300, bool), scene, Budget(0.2, min_opacity=min_opacity), 1)
    for camera in cameras:
        change = np.abs(render(gaussians, camera).rgb - render(both[0], camera).rgb).max()
        assert change <= both[2]["bound"]


@pytest.mark.parametrize(
    ("options", "field"),
    [({"stride": 3}, "stride"), ({"stride": True}, "stride"), ({"min_opacity": 1.1}, "min_opacity")],
)
def test_what_makes_no_sense_is_refused(options, field):
    with pytest.raises(InputError, match=field):
        Budget(**options)


def test_the_bound_is_that_of_what_is_faint_and_of_what_is_pruned_after_it():
    gaussians, cameras = clouds.cloud(300, 4, degree=1), [clouds.view(-0.1), clouds.view(0.1)]
    everything, scene = np.ones(300, bool), SceneViews(cameras)
    report = leave_out(gaussians, everything, scene, Budget(0.2, min_opacity=0.3), 1)[2]
    rest = gaussians[gaussians.opacities >= 0.3]
    pruned = prune(rest, certified_views(cameras, 1), 0.2, threads=1)
    assert pruned.bound > 0
    assert report["bound"] == pytest.approx(report["faint_bound"] + pruned.bound)
