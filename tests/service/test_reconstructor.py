"""Reconstruction with the stand-in network: its Gaussians are known in closed form, in any world and unit."""

import json
import math

import numpy as np
import pytest
from PIL import Image
from standin_model import BAND_1, C0, EXTRA, HEIGHT, OPACITY, ROTATION, SCALES, WIDTH

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.rotations import about_axis, matrix_from_quaternion
from gapmes.service.errors import (
    CameraError,
    ContradictionError,
    DepthRangeError,
    ImageError,
    InputError,
    ModelError,
    ViewCountError,
)
from gapmes.service.harmonics import evaluate_basis
from gapmes.service.kernels import warm_up
from gapmes.service.leaving_out.budget import KEEP_ALL, Budget
from gapmes.service.photographs.images import Photo, fit_view
from gapmes.service.photographs.masks import FADED, REPLACED
from gapmes.service.pictures.picture_error import psnr
from gapmes.service.reconstruct import Reconstructor
from gapmes.service.splat import Definition, render

# The network's frame is float32 with near = 1: positions up to `far / near` units carry 24 bits.
RTOL_F32 = 2e-6  # of the depth; worst 3e-7 over the cases below


@pytest.fixture(scope="module")
def reconstructor(engine):
    warm_up()
    return Reconstructor(engine)


@pytest.fixture(scope="module")
def scene(reconstructor, plane_scene):
    return reconstructor.reconstruct(
        plane_scene.images, plane_scene.cameras, near=plane_scene.near, far=plane_scene.far, budget=KEEP_ALL, fade=0
    )


def pixel_centres():
    return np.stack(np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5), -1).reshape(-1, 2)


def test_every_pixel_lies_on_the_ray_of_its_photograph(scene, plane_scene):
    """Pixel of the crop -> the network's point -> the caller's camera: the photograph's pixel, to 1e-4 px."""
    depth = math.sqrt(plane_scene.near * plane_scene.far)
    per_view = HEIGHT * WIDTH
    for index, (camera, view) in enumerate(zip(plane_scene.cameras, scene.view_cameras, strict=True)):
        means = scene.gaussians.means[index * per_view : (index + 1) * per_view]
        pixels, z = camera.project(means)
        np.testing.assert_allclose(z, depth, rtol=RTOL_F32)
        scale = min(camera.width / WIDTH, camera.height / HEIGHT)
        corner = (camera.width - WIDTH * scale) / 2, (camera.height - HEIGHT * scale) / 2
        np.testing.assert_allclose(pixels, pixel_centres() * scale + corner, atol=1e-4)
        np.testing.assert_allclose(means, view.unproject(pixel_centres(), np.full(per_view, depth)), rtol=0, atol=1e-5)


def test_scales_rotations_and_colours_are_in_the_world(scene, plane_scene):
    gaussians, first = scene.gaussians, plane_scene.cameras[0]
    depth = math.sqrt(plane_scene.near * plane_scene.far)
    np.testing.assert_allclose(gaussians.scales, np.tile(SCALES * depth, (len(gaussians), 1)), rtol=RTOL_F32)
    expected = first.rotation @ matrix_from_quaternion(ROTATION)
    np.testing.assert_allclose(matrix_from_quaternion(gaussians.rotations_wxyz[5]), expected, atol=1e-6)
    view = fit_view(Photo(plane_scene.images[1]), plane_scene.cameras[1], HEIGHT, WIDTH)
    dc = gaussians.harmonics[HEIGHT * WIDTH : 2 * HEIGHT * WIDTH, 0]
    np.testing.assert_allclose(0.5 + C0 * dc, view.image.reshape(3, -1).T, atol=1e-6)
    # the first band, seen from a world direction, is the network's seen from that direction in camera 0
    d = np.array([[0.6, -0.48, 0.64]])
    world = evaluate_basis(d, 1)[:, 1:] @ gaussians.harmonics[7, 1:]
    np.testing.assert_allclose(world, evaluate_basis(d @ first.rotation, 1)[:, 1:] @ BAND_1, atol=1e-6)


@pytest.mark.parametrize("unit", [1.0, 1e-3, 3.7, 1e4])
@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_gaussians_move_with_the_world(reconstructor, scene, plane_scene, unit, offset):
    """x -> unit R x + t: the same Gaussians moved, as far as float64 holds an origin that far away."""
    rotation = about_axis(np.array([0.48, -0.6, 0.64]), 2.3)
    translation = offset * unit * np.array([1.0, -0.7, 0.4])
    moved = plane_scene.moved(rotation, translation, unit)
    depths = {"near": moved.near, "far": moved.far}
    whole = reconstructor.reconstruct(moved.images, moved.cameras, **depths, budget=KEEP_ALL, fade=0)
    result = whole.gaussians
    # In units: float32 inside the frame, and the rounding of camera positions at the offset (2^-53 * 1e6 = 1e-10).
    atol = 1e-5 if offset == 0 else 1e-5 + 1e-9
    expected = scene.gaussians.means @ rotation.T
    assert result.means.dtype == np.float64
    np.testing.assert_allclose((result.means - translation) / unit, expected, rtol=0, atol=atol)
    np.testing.assert_allclose(result.scales, scene.gaussians.scales * unit, rtol=1e-6)
    np.testing.assert_array_equal(result.opacities, scene.gaussians.opacities)
    turned = rotation @ matrix_from_quaternion(scene.gaussians.rotations_wxyz[0])
    np.testing.assert_allclose(matrix_from_quaternion(result.rotations_wxyz[0]), turned, atol=1e-6)
    np.testing.assert_allclose(result.harmonics[:, 0], scene.gaussians.harmonics[:, 0], atol=1e-6)
    d = np.array([[0.0, 0.6, 0.8]])
    before = evaluate_basis(d, 1) @ scene.gaussians.harmonics[3]
    np.testing.assert_allclose(evaluate_basis(d @ rotation.T, 1) @ result.harmonics[3], before, atol=1e-6)
    one, other = whole.render(moved.cameras[0]).stats, scene.render(plane_scene.cameras[0]).stats
    assert (one["projected"], one["culled"]["near"]) == (other["projected"], 0)  # none lost to a near plane


def test_a_far_origin_keeps_every_pixel(reconstructor, plane_scene):
    """At 1e6 units a float32 world would be off by tens of pixels; here the rays still meet theirs."""
    moved = plane_scene.moved(np.eye(3), np.array([1e6, -2e6, 5e5]), 1.0)
    depths = {"near": moved.near, "far": moved.far}
    result = reconstructor.reconstruct(moved.images, moved.cameras, **depths, budget=KEEP_ALL, fade=0)
    pixels, _ = result.view_cameras[1].project(result.gaussians.means[HEIGHT * WIDTH : 2 * HEIGHT * WIDTH])
    np.testing.assert_allclose(pixels, pixel_centres(), atol=1e-4)  # worst 1.3e-5


def test_estimated_depths_move_with_the_world_too(reconstructor, plane_scene):
    plain = reconstructor.reconstruct(plane_scene.images, plane_scene.cameras, budget=KEEP_ALL, fade=0)
    moved = plane_scene.moved(about_axis(np.array([1.0, 0, 0]), 0.4), np.array([10.0, 20.0, -5.0]), 250.0)
    far_off = reconstructor.reconstruct(moved.images, moved.cameras, budget=KEEP_ALL, fade=0)
    assert plain.document["depth_range_source"] == "estimated"
    for name in ("near", "far"):
        assert far_off.document[name] == pytest.approx(250.0 * plain.document[name], rel=1e-6)
    np.testing.assert_allclose(far_off.gaussians.scales, 250 * plain.gaussians.scales, rtol=1e-5)


def test_document_is_plain_json_and_complete(scene, plane_scene, engine):
    document = json.loads(json.dumps(scene.document, allow_nan=False))
    assert document["model"]["file_sha256"] == engine.info.file_sha256
    assert (document["near"], document["far"], document["depth_range_source"]) == (2.0, 8.0, "given")
    assert len(document["cameras"]) == len(document["view_cameras"]) == len(plane_scene.cameras)
    assert document["gaussians"] == {"count": 3 * (HEIGHT * WIDTH + EXTRA), "sh_degree": 1, "added": 0}
    assert document["dropped"] == []
    assert document["warnings"] == []
    assert len(document["check"]["input_views"]) == len(plane_scene.cameras)
    assert document["check"]["no_parallax_share"] < 0.02  # corners that no other view has in its picture
    assert document["check"]["textureless_share"] < 0.05
    stages = ["cameras", "images", "network", "gaussians", "fade", "leave out", "check", "leave one out"]
    assert list(document["timings"]) == stages
    assert document["routing"]["patches_per_expert"] == {"0": 0, "1": 36, "2": 0, "3": 0, "4": 36}
    assert sum(document["routing"]["mean_task_weight"].values()) == pytest.approx(1)
    assert document["crop"][0]["kept_share"] == 1.0


def test_stages_are_heard_in_order(reconstructor, plane_scene):
    heard = []
    reconstructor.reconstruct(plane_scene.images, plane_scene.cameras, near=2, far=8, listener=heard.append)
    ended = [e.name for e in heard if e.seconds is not None]
    before, after = ["cameras", "images", "network"], ["gaussians", "fade", "leave out", "check", "leave one out"]
    assert ended == [*before, "refine", *after]
    assert [e.done for e in heard if e.name == "images"] == [0, 1, 2, 3, 4]


def test_kernels_are_loaded_after_the_network_and_once(reconstructor, plane_scene):
    warm_up.cache_clear()
    for expected in (
        ["network", "kernels", "refine", "gaussians", "fade", "leave out"],
        ["network", "refine", "gaussians", "fade", "leave out"],
    ):
        heard = []
        given = {"near": 2, "far": 8, "leave_one_out": 0}
        reconstructor.reconstruct(plane_scene.images, plane_scene.cameras, **given, listener=heard.append)
        ended = [e.name for e in heard if e.seconds is not None]
        assert ended[2 : 2 + len(expected)] == expected


def test_masked_pixels_and_patches_are_left_out_and_counted(reconstructor, plane_scene):
    images = []
    for image in plane_scene.images:
        alpha = np.full((*image.shape[:2], 1), 255, np.uint8)
        alpha[:, :40] = 0  # the left 40 of 96 columns: 26.67 of 64 in the crop
        images.append(np.concatenate([image, alpha], axis=2))
    result = reconstructor.reconstruct(images, plane_scene.cameras, near=2, far=8, budget=KEEP_ALL, fade=0)
    kept_columns = WIDTH - 27
    dropped = {entry["reason"]: entry["count"] for entry in result.document["dropped"]}
    assert dropped["opacity is 0"] == 3 * HEIGHT * 16  # one column of patches has no kept pixel
    assert dropped["its pixel is masked"] == 3 * HEIGHT * 11
    extra = len(result.gaussians) - 3 * HEIGHT * kept_columns
    assert extra + dropped.get("behind masked pixels only", 0) == 3 * EXTRA
    assert 0 < extra < 3 * EXTRA
    pixels, _ = result.view_cameras[0].project(result.gaussians.means[: HEIGHT * kept_columns])
    assert pixels[:, 0].min() > 27
    assert (result.gaussians.opacities == np.float32(OPACITY)).all()


def test_a_smaller_copy_of_the_photographs_gives_the_same_rays(reconstructor, plane_scene):
    """A camera file made for the originals goes with photographs of half the size."""
    doubled = [camera.resized(192, 144) for camera in plane_scene.cameras]
    given = {"near": 2, "far": 8, "budget": KEEP_ALL, "leave_one_out": 0}
    result = reconstructor.reconstruct(plane_scene.images, doubled, **given)
    plain = reconstructor.reconstruct(plane_scene.images, plane_scene.cameras, **given)
    np.testing.assert_array_equal(result.gaussians.means, plain.gaussians.means)


def test_more_views_than_two_and_in_any_order(reconstructor, plane_scene):
    order = [2, 0, 1]
    result = reconstructor.reconstruct(
        [plane_scene.images[i] for i in order], [plane_scene.cameras[i] for i in order], near=2, far=8,
        budget=KEEP_ALL, fade=0,
    )  # fmt: skip
    plain = reconstructor.reconstruct(plane_scene.images, plane_scene.cameras, near=2, far=8, budget=KEEP_ALL, fade=0)
    per_view = HEIGHT * WIDTH
    for place, index in enumerate(order):
        np.testing.assert_allclose(
            result.gaussians.means[place * per_view : (place + 1) * per_view],
            plain.gaussians.means[index * per_view : (index + 1) * per_view],
            atol=1e-5,
        )


def refused(reconstructor, plane_scene, error, match, *, images=None, cameras=None, **depths):
    images = plane_scene.images if images is None else images
    cameras = plane_scene.cameras if cameras is None else cameras
    with pytest.raises(error, match=match) as caught:
        reconstructor.reconstruct(images, cameras, **depths)
    return caught.value


def test_wrong_input_is_refused_with_its_index(reconstructor, plane_scene):
    images, cameras = list(plane_scene.images), list(plane_scene.cameras)
    refused(reconstructor, plane_scene, ViewCountError, "3 images and 2 cameras", cameras=cameras[:2])
    refused(reconstructor, plane_scene, ViewCountError, "1 view, need 2 to 6", images=images[:1], cameras=cameras[:1])
    refused(reconstructor, plane_scene, ViewCountError, "7 views", images=[images[0]] * 7, cameras=[cameras[0]] * 7)
    refused(reconstructor, plane_scene, DepthRangeError, "far is missing", near=1.0)
    error = refused(
        reconstructor, plane_scene, ImageError, "need uint8", images=[images[0], images[1] / 255, images[2]]
    )
    assert error.index == 1
    error = refused(
        reconstructor,
        plane_scene,
        ImageError,
        "72 x 96 px, its camera 96 x 72",
        images=[*images[:2], images[2].transpose(1, 0, 2)],
    )
    assert error.index == 2
    error = refused(reconstructor, plane_scene, CameraError, "is a dict", cameras=[*cameras[:2], {}])
    assert error.index == 2


def test_photographs_contradict_flipped_axes(reconstructor, plane_scene):
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    cameras = [camera.posed(camera.world_from_cam @ flip) for camera in plane_scene.cameras]
    error = refused(reconstructor, plane_scene, ContradictionError, "match with score", cameras=cameras, near=2, far=8)
    assert "OpenGL axes" in error.cure


def test_a_missing_model_is_named_at_once(tmp_path):
    with pytest.raises(ModelError, match="cannot be read"):
        Reconstructor(tmp_path / "none.onnx")


def test_near_and_far_beyond_float32_units(reconstructor, plane_scene):
    """A scene in units of 1e30: the network's frame divides by near, and only the last scaling is in float64."""
    moved = plane_scene.moved(np.eye(3), np.zeros(3), 1e30)
    result = reconstructor.reconstruct(moved.images, moved.cameras, near=moved.near, far=moved.far, budget=KEEP_ALL)
    assert np.isfinite(result.gaussians.means).all()
    assert isinstance(result.cameras[0], Camera)


def test_each_photograph_is_foretold_by_the_others(reconstructor, plane_scene):
    """What is told is the picture of a reconstruction without it, unless that is not wanted; two foretell none."""
    given = {"near": 2.0, "far": 8.0, "budget": KEEP_ALL}
    whole = reconstructor.reconstruct(plane_scene.images, plane_scene.cameras, **given)
    rows = whole.document["check"]["leave_one_out"]
    assert list(whole.document["timings"])[-1] == "leave one out"
    for index in range(3):
        rest = [i for i in range(3) if i != index]
        other = reconstructor.reconstruct(
            [plane_scene.images[i] for i in rest], [plane_scene.cameras[i] for i in rest], **given
        )
        assert other.document["check"]["leave_one_out"] is None
        image = render(other.gaussians, whole.view_cameras[index], near=0.2)
        view = fit_view(Photo(plane_scene.images[index]), plane_scene.cameras[index], HEIGHT, WIDTH)
        expected = psnr(np.clip(image.rgb, 0, 1).transpose(2, 0, 1), view.image)
        assert rows[index]["from"] == rest
        assert rows[index]["psnr"] == pytest.approx(expected, abs=1e-5)  # written with six decimals
        assert rows[index]["holes"] == pytest.approx((image.alpha < 0.5).mean(), abs=1e-6)
    without = reconstructor.reconstruct(plane_scene.images, plane_scene.cameras, leave_one_out=0, **given)
    assert without.document["check"]["leave_one_out"] is None
    assert "leave one out" not in without.document["timings"]


@pytest.mark.parametrize("stride", [1, 2])
def test_fading_lowers_opacities_of_pixels_and_says_so(reconstructor, plane_scene, stride):
    """What the network said of its views' agreement is told of the unfaded scene; what is gone is counted."""
    given = {"near": 2.0, "far": 8.0, "budget": Budget(None, stride=stride), "leave_one_out": 0}
    scenes = [reconstructor.reconstruct(plane_scene.images, plane_scene.cameras, **given, fade=n) for n in (0, 2, 1)]
    never, twice, once = (scene.document for scene in scenes)
    assert once["check"]["from_others"] == twice["check"]["from_others"]
    assert never["fading"]["passes"] == never["fading"]["gone"] == 0
    before, after = twice["fading"]["mean_opacity"]
    assert never["fading"]["mean_opacity"] == [before, before]
    assert after < before - 0.01
    assert never["fading"]["recoloured"] == 0
    assert 1e-4 < twice["fading"]["recoloured"] < 0.2
    dropped = {entry["reason"]: entry["count"] for entry in twice["dropped"]}
    assert dropped[REPLACED] == EXTRA * len(plane_scene.images)  # by as many as `added` says
    added = twice["gaussians"]["added"] - dropped[REPLACED]
    assert added > 0
    assert dropped[FADED] == twice["fading"]["gone"] == len(scenes[0].gaussians) + added - len(scenes[1].gaussians)
    pairs = zip(never["check"]["input_views"], twice["check"]["input_views"], strict=True)
    assert all(faded["psnr"] > plain["psnr"] for plain, faded in pairs)


def test_photographs_may_be_paths_or_bytes(reconstructor, plane_scene, tmp_path):
    paths = [tmp_path / f"{index}.png" for index in range(len(plane_scene.images))]
    for path, image in zip(paths, plane_scene.images, strict=True):
        Image.fromarray(image).save(path)
    options = {"near": plane_scene.near, "far": plane_scene.far, "fade": 0, "leave_one_out": 0}
    expected = reconstructor.reconstruct(plane_scene.images, plane_scene.cameras, **options).gaussians
    for given in (paths, [str(path) for path in paths], [path.read_bytes() for path in paths]):
        found = reconstructor.reconstruct(given, plane_scene.cameras, **options).gaussians
        np.testing.assert_array_equal(found.means, expected.means)
        np.testing.assert_array_equal(found.harmonics, expected.harmonics)
    with pytest.raises(ImageError, match=r"none\.png cannot be read: No such file") as caught:
        reconstructor.reconstruct([paths[0], tmp_path / "none.png"], plane_scene.cameras[:2], **options)
    assert caught.value.index == 1


def test_numbers_that_are_too_few_are_refused(reconstructor, plane_scene):
    with pytest.raises(InputError, match="1 numbers, need one per image"):
        reconstructor.reconstruct(plane_scene.images[:2], plane_scene.cameras[:2], numbers=[3])


def test_a_definition_keeps_its_own_near_plane(reconstructor, plane_scene):
    """Else it would be silently another one; without one the picture begins at a tenth of the scene's near depth."""
    scene = reconstructor.reconstruct(plane_scene.images, plane_scene.cameras, near=2, far=8, leave_one_out=0)
    camera = scene.view_cameras[0]
    depths = camera.project(scene.gaussians.means)[1]
    between = Definition(near=float(np.median(depths)))
    for options in ({"definition": between}, {"compatibility": "inria"}, {"near": 3.0}):
        drawn, expected = scene.render(camera, **options), render(scene.gaussians, camera, **options)
        np.testing.assert_array_equal(drawn.rgb, expected.rgb)
        assert drawn.stats["culled"] == expected.stats["culled"]
    assert scene.render(camera, definition=between).stats["culled"]["near"] > 100
    for nothing in ({}, {"definition": None, "near": None}):
        drawn = scene.render(camera, **nothing)
        np.testing.assert_array_equal(drawn.rgb, render(scene.gaussians, camera, near=0.2).rgb)
        assert drawn.stats["culled"]["near"] == (depths <= 0.2).sum()
