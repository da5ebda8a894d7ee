"""The whole network: presets and ablations build, batches are independent, masks leave patches out, gradients reach all
weights."""

from __future__ import annotations

import pytest
import torch
from small_networks import scene, tiny

from gapmes.model.config import PRESETS, ModelConfig, preset
from gapmes.model.layers import softmax_of_channels
from gapmes.model.network import GaPMeS


@pytest.fixture(scope="module")
def network() -> GaPMeS:
    return tiny()


ABLATIONS = ["without_depth", "without_experts", "without_tasks"]


@pytest.mark.parametrize("views", [2, 3, 4])
def test_one_gaussian_per_pixel_and_a_backing_layer(network: GaPMeS, views: int) -> None:
    images, k, poses, near_far = scene(1, views, 64)
    with torch.no_grad():
        prediction = network(images, k, poses, near_far)
    g = prediction.gaussians
    count = views * (64 * 64 + (8 + 4) ** 2)  # 8 cells a side and a margin of two on both
    assert g.means.shape == (1, count, 3)
    assert g.harmonics.shape == (1, count, 1, 3)
    for value in (g.means, g.scales, g.rotations_wxyz, g.opacities, g.harmonics):
        assert torch.isfinite(value).all()
    assert (g.scales > 0).all()
    assert ((g.opacities > 0) & (g.opacities < 1)).all()
    torch.testing.assert_close(g.rotations_wxyz.norm(dim=-1), torch.ones(1, count), atol=1e-5, rtol=0)
    near, far = near_far[0].tolist()
    assert float(prediction.depth.min()) > near / 1.4  # the head may step a little in front of `near`
    assert float(prediction.depth.max()) <= far * 1.0001


@pytest.mark.case("R5")
def test_swapping_scenes_of_a_batch_swaps_the_results(network: GaPMeS) -> None:
    one = scene(2, 2, 64, seed=5)
    with torch.no_grad():
        straight = network(*one)
        swapped = network(*(value.flip(0) for value in one))
    # every product is the same, only its place in the batch differs: measured 0 difference on one thread
    torch.testing.assert_close(swapped.gaussians.means.flip(0), straight.gaussians.means, atol=1e-5, rtol=1e-5)
    routes = swapped.routing.expert_index.reshape(2, -1).flip(0)
    assert torch.equal(routes, straight.routing.expert_index.reshape(2, -1))


def test_evaluation_is_deterministic_and_draws_no_noise(network: GaPMeS) -> None:
    one = scene(1, 2, 64)
    torch.manual_seed(0)
    with torch.no_grad():
        first = network(*one)
    torch.manual_seed(1)
    with torch.no_grad():
        second = network(*one)
    assert torch.equal(first.gaussians.means, second.gaussians.means)
    assert torch.equal(first.routing.expert_index, second.routing.expert_index)


@pytest.mark.case("S2")
def test_left_out_patches_have_no_weight_and_opacity_exactly_zero(network: GaPMeS) -> None:
    images, k, poses, near_far = scene(1, 2, 64)
    mask = torch.ones(1, 2, 16, dtype=torch.bool)
    mask[0, 0, 5] = False
    with torch.no_grad():
        full = network(images, k, poses, near_far)
        masked = network(images, k, poses, near_far, mask)
    pixels = masked.gaussians.opacities[0, : 2 * 64 * 64].reshape(2, 64, 64)
    assert (pixels[0, 16:32, 16:32] == 0).all()
    assert int((pixels == 0).sum()) == 256
    assert not masked.routing.expert_weight[5].any()
    assert not masked.routing.task_weight[5].any()
    far_away = (slice(None), slice(48, 64), slice(48, 64))
    assert torch.equal(full.gaussians.opacities[0, : 2 * 64 * 64].reshape(2, 64, 64)[far_away], pixels[far_away])


@pytest.mark.parametrize("switch", ABLATIONS)
def test_ablations_build_run_and_train(switch: str) -> None:
    network = tiny(**{switch: True}).train()
    prediction = network(*scene(1, 2, 64))
    (prediction.gaussians.means.square().mean() + prediction.gaussians.opacities.mean()).backward()
    assert float(network.heads.alpha.out.weight.grad.abs().sum()) > 0
    if switch == "without_experts":
        assert network.mixture.experts is None
    if switch == "without_depth":
        assert network.mono is None
        assert network.mixture.channels == 2 * network.config.stream_channels


def test_without_tasks_every_head_reads_the_same_map() -> None:
    network = tiny(without_tasks=True)
    streams = {name: torch.randn(1, c, 16, 16) for name, c in (("texture", 64), ("semantic", 96), ("depth", 114))}
    maps = network.mixture(streams, streams["texture"], torch.ones(16)).maps
    assert all(torch.equal(maps[0], other) for other in maps[1:])


def test_gradient_reaches_gates_experts_and_balance_from_a_loss_on_gaussians() -> None:
    torch.manual_seed(0)
    network = tiny().train()
    prediction = network(*scene(1, 2, 64))
    g = prediction.gaussians
    loss = g.means.square().mean() + g.scales.log().mean() + g.opacities.square().mean() + g.harmonics.square().mean()
    loss.backward()
    silent = {n for n, p in network.named_parameters() if p.requires_grad and (p.grad is None or not p.grad.any())}
    # experts that no patch chose have no gradient
    chosen = set(prediction.routing.expert_index.unique().tolist())
    idle = {n for n in silent if n.startswith("mixture.experts.")}
    assert silent == idle
    assert all(int(n.split(".")[3]) not in chosen for n in idle)
    for name in ("expert_gate.weight", "task_gate.weight", "expert_balance", "task_balance"):
        gradient = network.mixture.gates.get_parameter(name).grad
        assert float(gradient.abs().sum()) > 0, name


@pytest.mark.parametrize("name", ["small", "base"])
def test_larger_presets_have_the_published_backbones(name: str) -> None:
    config = PRESETS[name]
    vit = config.semantic_vit
    assert (vit.hidden, vit.layers, vit.heads, vit.patch) == {
        "small": (384, 12, 6, 14),
        "base": (768, 12, 12, 14),
    }[name]
    assert (config.experts, config.top_k, config.temperature) == (6, 2, 0.8)


def test_small_preset_runs_with_frozen_backbones() -> None:
    network = GaPMeS(preset("small")).eval()
    assert not any(p.requires_grad for p in network.semantic.vit.parameters())
    with torch.no_grad():
        prediction = network(*scene(1, 2, 64))
    assert prediction.gaussians.harmonics.shape[2] == 9
    assert torch.isfinite(prediction.gaussians.means).all()


def test_config_survives_json() -> None:
    for config in PRESETS.values():
        assert ModelConfig.from_json(config.to_json()) == config


def test_unknown_preset_lists_the_known_ones() -> None:
    with pytest.raises(KeyError, match="tiny, small, base"):
        preset("huge")


def test_tiny_has_between_one_and_four_million_parameters(network: GaPMeS) -> None:
    assert 1e6 < network.trainable_parameters() < 4e6


def test_the_exported_softmax_is_a_softmax() -> None:
    class Softmax(torch.nn.Module):
        def forward(self, x: torch.Tensor) -> torch.Tensor:
            return softmax_of_channels(x)

    x = 200 * torch.randn(2, 9, 3, 4, generator=torch.Generator().manual_seed(0))  # exp alone would overflow
    program = torch.export.export(Softmax(), (x,))
    assert "aten.softmax.int" not in {str(node.target) for node in program.graph.nodes}
    torch.testing.assert_close(program.module()(x), x.softmax(1), atol=1e-6, rtol=0)
