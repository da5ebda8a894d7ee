"""Experts: running only routed patches gives the dense result, order does not matter, idle experts do nothing."""

from __future__ import annotations

import pytest
import torch

from gapmes.model.config import preset
from gapmes.model.experts import ExpertGroup
from gapmes.model.routing import Routing, hybrid_weights, top_k_lowest_first
from gapmes.model.streams import PatchMixture, from_patches, to_patches

CHANNELS, STREAMS, EXPERTS = 8, 3, 6


def group() -> ExpertGroup:
    torch.manual_seed(0)
    return ExpertGroup(EXPERTS, CHANNELS).eval()


def routing_of(logits: torch.Tensor, k: int = 2) -> Routing:
    index = top_k_lowest_first(logits, k)
    weight = hybrid_weights(torch.softmax(logits.gather(-1, index), -1), torch.tensor(0.4))
    return Routing(index, weight, torch.full((len(logits), 4), 0.25), None, torch.zeros(()))


def logits_for(kind: str, patches: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(7)
    logits = torch.randn(patches, EXPERTS, generator=generator)
    if kind == "tied":
        logits.zero_()
    if kind == "two of six":
        logits[:, [1, 4]] += 100
    return logits


@pytest.mark.case("R5", "S2")
@pytest.mark.parametrize("kind", ["random", "tied", "two of six"])
@pytest.mark.parametrize("patches", [1, 37])
def test_sparse_equals_dense(kind: str, patches: int) -> None:
    x = torch.randn(patches, STREAMS * CHANNELS, 4, 4, generator=torch.Generator().manual_seed(1))
    routing = routing_of(logits_for(kind, patches))
    with torch.no_grad():
        sparse, dense = group()(x, routing), group().dense(x, routing)
    # both sum the same products; a convolution may group them by its batch size: measured 0 on one thread, allowed 2e-6
    torch.testing.assert_close(sparse, dense, atol=2e-6 * float(dense.abs().max()), rtol=0)


@pytest.mark.case("R5")
def test_permuting_patches_permutes_the_result() -> None:
    x = torch.randn(40, STREAMS * CHANNELS, 4, 4, generator=torch.Generator().manual_seed(2))
    logits, order = logits_for("random", 40), torch.randperm(40, generator=torch.Generator().manual_seed(3))
    with torch.no_grad():
        straight, permuted = group()(x, routing_of(logits)), group()(x[order], routing_of(logits[order]))
    torch.testing.assert_close(permuted, straight[order], atol=2e-6 * float(straight.abs().max()), rtol=0)


@pytest.mark.case("R5", "S2")
def test_an_expert_runs_on_exactly_the_patches_that_chose_it() -> None:
    experts, counts = group(), {}
    for number, expert in enumerate(experts.experts):
        expert.register_forward_hook(
            lambda _m, inputs, _o, number=number: counts.__setitem__(number, inputs[0].shape[0])
        )
    logits = logits_for("two of six", 25)
    logits[:5, 3] += 200
    routing = routing_of(logits)
    with torch.no_grad():
        experts(torch.randn(25, STREAMS * CHANNELS, 4, 4), routing)
    chosen = torch.bincount(routing.expert_index.flatten(), minlength=EXPERTS) * STREAMS
    assert [counts[e] for e in range(EXPERTS)] == chosen.tolist()
    assert counts[0] == counts[2] == counts[5] == 0


@pytest.mark.case("S2")
def test_a_weight_of_exactly_zero_is_not_computed() -> None:
    experts, seen = group(), []
    for expert in experts.experts:
        expert.register_forward_hook(lambda _m, inputs, _o: seen.append(inputs[0].shape[0]))
    index = torch.tensor([[0, 1], [2, 1]])
    routing = Routing(index, torch.tensor([[1.0, 0.0], [0.0, 0.0]]), torch.zeros(2, 4), None, torch.zeros(()))
    with torch.no_grad():
        out = experts(torch.randn(2, STREAMS * CHANNELS, 4, 4), routing)
    assert sum(seen) == STREAMS
    assert not out[1].any()


def test_patches_are_cut_and_joined_without_loss() -> None:
    grid = torch.randn(3, 5, 12, 20, generator=torch.Generator().manual_seed(4))
    patches = to_patches(grid)
    assert patches.shape == (3 * 3 * 5, 5, 4, 4)
    assert torch.equal(from_patches(patches, 12, 20), grid)
    assert torch.equal(patches[7], grid[0, :, 4:8, 8:12])  # row-major: patch 7 is row 1, column 2 of 5


def test_gradient_reaches_chosen_experts_gates_and_balance() -> None:
    torch.manual_seed(0)
    config = preset("tiny")
    channels = {"depth": 10, "texture": 11, "semantic": 12}
    mixture = PatchMixture(config, channels).train()
    streams = {name: torch.randn(2, count, 16, 16) for name, count in channels.items()}
    tasks = mixture(streams, streams["depth"], torch.ones(2 * 16))
    sum((m**2).sum() for m in tasks.maps).backward()
    assert tasks.routing is not None
    for number in tasks.routing.expert_index.unique().tolist():
        assert float(mixture.experts.experts[number].layers[0].weight.grad.abs().sum()) > 0
    for parameter in (
        mixture.gates.expert_gate.weight,
        mixture.gates.task_gate.weight,
        mixture.gates.expert_balance,
        mixture.gates.task_balance,
        mixture.align["texture"].weight,
    ):
        assert float(parameter.grad.abs().sum()) > 0
