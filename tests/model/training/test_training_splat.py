"""The differentiable splatter against its definition in float64, and its gradients against two independent ones."""

import numba
import numpy as np
import pytest
import torch
from splat_float64 import splat_reference

from gapmes.model.training.splat import splat
from gapmes.service import Camera, Gaussians, render
from gapmes.service.cameras.rotations import matrix_from_quaternion

NAMES = ("means", "factors", "opacities", "colours")
SIZE = (20, 24)

# Worst of 40 seeds: forward 2.3e-7 away from thresholds, gradients 7e-7 of the largest entry.
FORWARD_ATOL = 1e-6
GRADIENT_RTOL = 3e-6
THRESHOLD_MARGIN = 1e-4  # relative distance to the alpha cut or the stop below which float32 may decide differently


@pytest.fixture(autouse=True, scope="module")
def _one_thread():
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    yield
    numba.set_num_threads(before)


def make_scene(seed, count=40, batch=2, views=2, opacity=(0.05, 1.0), spread=0.7, size=0.12):
    """Random Gaussians in front of slightly turned cameras; two of them lie behind, one far off to the side."""
    rng = torch.Generator().manual_seed(seed)
    means = torch.randn(batch, count, 3, generator=rng) * spread + torch.tensor([0.0, 0.0, 2.5])
    means[:, 0, 2] = -1.0
    means[:, 1] = torch.tensor([3.0, -0.2, 1.5])  # beyond the field-of-view margin
    factors = torch.randn(batch, count, 3, 3, generator=rng) * size
    factors[:, 1] *= 6
    opacities = opacity[0] + (opacity[1] - opacity[0]) * torch.rand(batch, count, generator=rng)
    colours = torch.rand(batch, count, 3, generator=rng)
    pose = torch.eye(4).repeat(batch, views, 1, 1)
    skew = 0.15 * torch.randn(batch, views, 3, 3, generator=rng)
    pose[..., :3, :3] = torch.linalg.matrix_exp(skew - skew.mT)
    pose[..., :3, 3] = 0.2 * torch.randn(batch, views, 3, generator=rng)
    k = torch.tensor([[20.0, 0, 11.5], [0, 23.0, 10.4], [0, 0, 1]]).repeat(batch, views, 1, 1)
    return (means, factors, opacities, colours), pose, k


@pytest.mark.parametrize("seed", range(8))
def test_forward_equals_float64_reference(seed):
    scene, pose, k = make_scene(seed)
    rgb, alpha = splat(*scene, pose, k, *SIZE, background=(0.2, 0.5, 0.9))
    want_rgb, want_alpha, margin = splat_reference(
        *(value.double() for value in scene), pose, k, *SIZE, background=(0.2, 0.5, 0.9)
    )
    clear = margin > THRESHOLD_MARGIN
    assert clear.float().mean() > 0.95
    assert ((rgb - want_rgb).abs().amax(2)[clear] < FORWARD_ATOL).all()
    assert ((alpha - want_alpha).abs()[:, :, 0][clear] < FORWARD_ATOL).all()
    assert ((rgb - want_rgb).abs() < 1.5 / 255).all()  # a decision that differs costs at most one faint splat


def test_saturated_stack_stops_inclusively():
    """Twenty opaque layers, clamped at 0.99: the second takes T to 1e-4, is still added, and hides the rest."""
    means = torch.tensor([[[0.0, 0.0, 1.0 + 0.1 * i] for i in range(20)]])
    factors = torch.eye(3).expand(1, 20, 3, 3) * 50.0
    colours = torch.linspace(0, 1, 20)[None, :, None].expand(1, 20, 3)
    k = torch.tensor([[[[8.0, 0, 4], [0, 8, 4], [0, 0, 1]]]])
    scene = (means, factors, torch.ones(1, 20), colours)
    rgb, alpha = splat(*scene, torch.eye(4)[None, None], k, 8, 8)
    first, second = (float(colours[0, i, 0]) for i in (0, 1))
    assert float(rgb[0, 0, 0, 4, 4]) == pytest.approx(0.99 * first + 0.0099 * second, abs=1e-7)
    assert float(alpha[0, 0, 0, 4, 4]) == pytest.approx(0.9999, abs=1e-7)


@pytest.mark.parametrize("seed", range(6))
def test_gradients_equal_float64_autograd(seed):
    scene, pose, k = make_scene(seed + 100)
    single = [value.clone().requires_grad_() for value in scene]
    double = [value.double().requires_grad_() for value in scene]
    rgb, alpha = splat(*single, pose, k, *SIZE, background=(0.3, 0.1, 0.7))
    want_rgb, want_alpha, margin = splat_reference(*double, pose, k, *SIZE, background=(0.3, 0.1, 0.7))
    rng = torch.Generator().manual_seed(seed)
    clear = (margin > THRESHOLD_MARGIN)[:, :, None]
    weight = torch.randn(rgb.shape, generator=rng) * clear
    weight_alpha = torch.randn(alpha.shape, generator=rng) * clear
    got = torch.autograd.grad((rgb * weight).sum() + (alpha * weight_alpha).sum(), single)
    want = torch.autograd.grad((want_rgb * weight).sum() + (want_alpha * weight_alpha).sum(), double)
    for name, a, b in zip(NAMES, got, want, strict=True):
        assert float((a - b).abs().max() / b.abs().max()) < GRADIENT_RTOL, name


def test_gradients_equal_central_differences():
    """The chain is also held to the definition itself, with no autograd in between, one number at a time."""
    scene, pose, k = make_scene(7, count=5, batch=1, views=1)
    size = (10, 12)
    weight = torch.randn(1, 1, 3, *size, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    single = [value.clone().requires_grad_() for value in scene]
    grads = torch.autograd.grad((splat(*single, pose, k, *size)[0] * weight).sum(), single)
    double = [value.double() for value in scene]
    step = 1e-6
    for which, name in enumerate(NAMES):
        flat = double[which].reshape(-1)
        numeric = torch.zeros_like(flat)
        for i in range(flat.numel()):
            values = []
            for sign in (1, -1):
                moved = flat.clone()
                moved[i] += sign * step
                args = [moved.view_as(v) if n == which else v for n, v in enumerate(double)]
                values.append((splat_reference(*args, pose, k, *size)[0] * weight).sum())
            numeric[i] = (values[0] - values[1]) / (2 * step)
        error = (grads[which].reshape(-1) - numeric).abs().max() / numeric.abs().max()
        assert float(error) < 1e-4, name  # measured 2e-6 and below


def test_clamped_alpha_has_no_gradient_and_faint_ones_are_cut():
    k = torch.tensor([[[[8.0, 0, 4.5], [0, 8, 4.5], [0, 0, 1]]]])
    means = torch.tensor([[[0.0, 0.0, 1.0], [0.0, 0.0, 2.0]]])
    factors = torch.eye(3).expand(1, 2, 3, 3) * 100.0
    opacities = torch.tensor([[1.0, 1 / 256]], requires_grad=True)
    rgb, alpha = splat(means, factors, opacities, torch.ones(1, 2, 3), torch.eye(4)[None, None], k, 9, 9)
    (rgb.sum() + alpha.sum()).backward()
    assert (opacities.grad == 0).all()
    assert float(alpha.detach().max()) == pytest.approx(0.99, abs=1e-6)


def test_empty_view_is_the_background():
    scene, pose, k = make_scene(3)
    pose[..., :3, 3] += torch.tensor([0.0, 0.0, 100.0])
    rgb, alpha = splat(*scene, pose, k, *SIZE, background=(0.25, 0.5, 0.75))
    assert (alpha == 0).all()
    assert (rgb == torch.tensor([0.25, 0.5, 0.75])[:, None, None]).all()


def test_same_bits_for_any_number_of_threads_and_any_order_of_distinct_depths():
    scene, pose, k = make_scene(11)
    permutation = torch.randperm(scene[0].shape[1], generator=torch.Generator().manual_seed(5))
    runs = []
    for threads in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
        numba.set_num_threads(threads)
        values = [value.clone().requires_grad_() for value in scene]
        rgb, alpha = splat(*values, pose, k, *SIZE)
        runs.append((rgb, alpha, *torch.autograd.grad((rgb**2).sum() + alpha.sum(), values)))
    numba.set_num_threads(1)
    for a, b in zip(*runs, strict=True):
        assert torch.equal(a, b)
    permuted = splat(*(value[:, permutation] for value in scene), pose, k, *SIZE)
    assert torch.equal(permuted[0], runs[0][0])


def test_a_large_image_sorts_like_numpy():
    """Depths that collide in float32 are still ordered by their float64 value, then by index."""
    from gapmes.model.training.splat_projection import depth_order

    rng = np.random.default_rng(0)
    depths = 1.0 + rng.integers(0, 500, 4000) * 1e-9 + rng.integers(0, 3, 4000)
    np.testing.assert_array_equal(depth_order(depths, len(depths)), np.argsort(depths, kind="stable"))


def test_a_wall_across_the_view_sorts_like_numpy():
    """Its depths are equal but for rounding: hardly any differ in float32, and insertion would take seconds."""
    from gapmes.model.training.splat_projection import depth_order

    depths = 2 + 1e-8 * np.random.default_rng(0).integers(0, 1000, 100_000)
    np.testing.assert_array_equal(depth_order(depths, len(depths)), np.argsort(depths, kind="stable"))


@pytest.mark.parametrize("name", NAMES)
def test_refuses_nan_by_name(name):
    scene, pose, k = make_scene(0)
    values = dict(zip(NAMES, scene, strict=True))
    values[name] = values[name].clone()
    values[name].view(-1)[3] = float("nan")
    with pytest.raises(ValueError, match=f"{name}: 1 of"):
        splat(*values.values(), pose, k, *SIZE)


def test_refuses_wrong_shapes_by_name():
    scene, pose, k = make_scene(0)
    with pytest.raises(ValueError, match=r"intrinsics: shape is \(2, 1, 3, 3\)"):
        splat(*scene, pose, k[:, :1], *SIZE)


@pytest.mark.parametrize("seed", range(4))
def test_forward_equals_the_renderer_of_the_service(seed):
    """What training optimises is what is served: the same Gaussians, cameras and background, two implementations."""
    rng = np.random.default_rng(seed)
    count, width, height = 300, 48, 40
    gaussians = Gaussians.make(
        rng.normal((0, 0, 2), 0.8, (count, 3)).astype(np.float32),
        np.exp(rng.uniform(-5, -1, (count, 3))),
        rng.normal(size=(count, 4)),
        rng.uniform(0, 1, count),
        rng.normal(0, 0.7, (count, 1, 3)),
    )
    pose = np.eye(4)
    pose[:3, :3] = matrix_from_quaternion(np.array([1.0, 0.05, -0.08, 0.03]) / np.linalg.norm([1.0, 0.05, -0.08, 0.03]))
    camera = Camera.make(width, height, 44.0, 41.0, 21.0, 23.5, pose)
    served = render(gaussians, camera, background=(0.1, 0.6, 0.3), near=0.05, threads=1)

    factors = matrix_from_quaternion(gaussians.rotations_wxyz) * gaussians.scales[:, None, :]
    colours = np.maximum(0.5 + 0.28209479177387814 * gaussians.harmonics[:, 0].astype(np.float64), 0)
    rgb, alpha = splat(
        *(torch.from_numpy(v)[None] for v in (gaussians.means, factors, gaussians.opacities, colours)),
        torch.from_numpy(camera.world_from_cam)[None, None],
        torch.from_numpy(camera.intrinsics)[None, None],
        height,
        width,
        background=(0.1, 0.6, 0.3),
        near=0.05,
    )
    difference = np.abs(rgb[0, 0].permute(1, 2, 0).numpy() - served.rgb).max(axis=-1)
    assert np.quantile(difference, 0.999) < 1e-5
    assert difference.max() < 1.5 / 255  # a pixel on the edge of the alpha cut may differ by one faint layer
    assert np.quantile(np.abs(alpha[0, 0, 0].numpy() - served.alpha), 0.999) < 1e-5
