"""Routing axioms: weights sum to one, ties go to the lowest index, noise only in training."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gapmes.model.routing import Gates, decisiveness, gumbel_noise, hybrid_weights, top_k_lowest_first


def gates(experts: int = 6, k: int = 2, tau: float = 0.8) -> Gates:
    torch.manual_seed(1)
    return Gates(48, experts, k, tau).eval()


@pytest.mark.case("R1")
@pytest.mark.parametrize("experts", [1, 2, 6, 64])
def test_all_ties_take_the_lowest_indices(experts: int) -> None:
    for k in range(1, min(experts, 5) + 1):
        assert top_k_lowest_first(torch.zeros(3, experts), k).tolist() == [list(range(k))] * 3


@pytest.mark.case("R1")
@settings(max_examples=60)
@given(st.lists(st.integers(-3, 3), min_size=4, max_size=8), st.integers(1, 4))
def test_top_k_is_a_stable_sort(values: list[int], k: int) -> None:
    expected = sorted(range(len(values)), key=lambda i: (-values[i], i))[:k]
    assert top_k_lowest_first(torch.tensor([values], dtype=torch.float32), k).tolist() == [expected]


@pytest.mark.case("R4")
@pytest.mark.parametrize("balance", [0.0, 0.3, 1.0])
def test_hybrid_weights_sum_to_one_and_are_not_negative(balance: float) -> None:
    soft = torch.softmax(torch.randn(100, 4, generator=torch.Generator().manual_seed(0)), -1)
    weights = hybrid_weights(soft, torch.tensor(balance))
    # each weight is a sum of two products of float32 numbers up to 1: four roundings of 6e-8
    torch.testing.assert_close(weights.sum(-1), torch.ones(100), atol=3e-7, rtol=0)
    assert (weights >= 0).all()


@pytest.mark.case("R4")
def test_balance_is_between_the_hard_and_the_soft_choice() -> None:
    soft = torch.tensor([[0.2, 0.5, 0.3]])
    torch.testing.assert_close(hybrid_weights(soft, torch.tensor(1.0)), torch.tensor([[0.0, 1.0, 0.0]]))
    torch.testing.assert_close(hybrid_weights(soft, torch.tensor(0.0)), soft)
    torch.testing.assert_close(hybrid_weights(soft, torch.tensor(0.5)), torch.tensor([[0.1, 0.75, 0.15]]))


def test_weights_of_the_gates_sum_to_one() -> None:
    routing = gates()(torch.randn(200, 48, generator=torch.Generator().manual_seed(2)))
    torch.testing.assert_close(routing.expert_weight.sum(-1), torch.ones(200), atol=3e-7, rtol=0)
    torch.testing.assert_close(routing.task_weight.sum(-1), torch.ones(200), atol=3e-7, rtol=0)


@pytest.mark.case("R3")
@pytest.mark.parametrize("scale", [1e4, 1e30, 3e38])
def test_huge_logits_give_finite_weights(scale: float) -> None:
    g = gates()
    with torch.no_grad():
        g.expert_gate.weight.zero_()
        g.expert_gate.bias.copy_(torch.tensor([0.0, 1, -1, 0.5, 1, -0.5]) * scale)
    routing = g(torch.zeros(2, 48))
    assert routing.expert_index.tolist() == [[1, 4], [1, 4]]
    assert torch.isfinite(routing.expert_weight).all()


@pytest.mark.case("R2")
@pytest.mark.parametrize(
    ("row", "deciding", "margin"),
    [
        ([4.0, 3.0, 2.5, 0.0], 1, 0.25),  # whether the first is first
        ([4.0, 3.0, 2.5, 0.0], 2, 0.125),  # and whether the second is chosen
        ([0.0, 2.5, 4.0, 3.5], 2, 0.125),
        ([-4.0, -5.0, -8.0, -8.0], 2, 0.125),
        ([-4.0, -5.0, -8.0, -8.0], 3, 0.0),
        ([5.0, 5.0, 0.0, 0.0], 1, 0.0),
        ([0.0, 0.0, 0.0, 0.0], 2, 0.0),
        ([7.0], 1, 2.0),
    ],
)
def test_the_margin_is_the_least_gap_that_decides(row: list[float], deciding: int, margin: float) -> None:
    assert decisiveness(torch.tensor([row]), deciding).tolist() == [margin]


@pytest.mark.case("R5")
def test_permuting_patches_permutes_their_routes() -> None:
    x = torch.randn(64, 48, generator=torch.Generator().manual_seed(8))
    order = torch.randperm(64, generator=torch.Generator().manual_seed(9))
    straight, permuted = gates()(x), gates()(x[order])
    assert torch.equal(permuted.expert_index, straight.expert_index[order])
    torch.testing.assert_close(permuted.expert_weight, straight.expert_weight[order], atol=1e-6, rtol=0)
    torch.testing.assert_close(permuted.task_weight, straight.task_weight[order], atol=1e-6, rtol=0)


@pytest.mark.case("R3")
@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_logits_that_are_not_numbers_show_in_the_weights(value: float) -> None:
    """The engine refuses outputs that are not finite, so a broken gate must not come out as a plausible route."""
    g = gates()
    with torch.no_grad():
        g.expert_gate.bias[1] = value
    assert not torch.isfinite(g(torch.zeros(1, 48)).expert_weight).all()
    with torch.no_grad():
        g.expert_gate.bias.fill_(-float("inf"))
    assert not torch.isfinite(g(torch.zeros(1, 48)).expert_weight).any()


def test_no_noise_in_evaluation_and_noise_in_training() -> None:
    g, x = gates(), torch.randn(64, 48, generator=torch.Generator().manual_seed(3))
    first, second = g(x), g(x)
    assert torch.equal(first.expert_index, second.expert_index)
    assert torch.equal(first.expert_weight, second.expert_weight)
    g.train()
    torch.manual_seed(0)
    noisy, again = g(x), g(x)
    assert not torch.equal(noisy.expert_index, again.expert_index)
    g.noise_scale = 0.0
    assert torch.equal(g(x).expert_index, first.expert_index)


def test_gumbel_noise_has_the_distribution_of_its_formula() -> None:
    noise = gumbel_noise(torch.zeros(200_000), torch.Generator().manual_seed(5)).double()
    # mean is Euler's constant, variance pi^2 / 6; three standard errors at this sample size are 0.009 and 0.023
    assert abs(float(noise.mean()) - 0.57722) < 0.009
    assert abs(float(noise.var()) - 1.64493) < 0.03


def test_gumbel_top_k_samples_in_proportion_to_the_softmax() -> None:
    logits = torch.tensor([1.0, 0.0, -1.0]).repeat(100_000, 1)
    noisy = logits + gumbel_noise(logits, torch.Generator().manual_seed(6))
    share = torch.bincount(top_k_lowest_first(noisy, 1).flatten(), minlength=3) / len(logits)
    torch.testing.assert_close(share, torch.softmax(logits[0], -1), atol=0.006, rtol=0)


def test_balance_loss_is_one_when_even_and_larger_when_not() -> None:
    g = gates()
    even = torch.eye(6).repeat(8, 1) * 10  # every expert is first equally often, and second by the same turn
    even = even + torch.eye(6).roll(1, 1).repeat(8, 1) * 5
    with torch.no_grad():
        g.expert_gate.weight.zero_()
        g.expert_gate.weight[:, :6] = torch.eye(6)
        g.expert_gate.bias.zero_()
    query = torch.zeros(48, 48)
    query[:, :6] = even
    assert float(g(query).balance_loss.detach()) == pytest.approx(1.0, abs=1e-5)
    with torch.no_grad():
        g.expert_gate.weight.zero_()
        g.expert_gate.bias[2] = 5.0
    assert float(g(torch.randn(32, 48)).balance_loss.detach()) > 2.5


def test_gradient_reaches_both_gates_and_both_balances() -> None:
    g = gates().train()
    routing = g(torch.randn(16, 48))
    loss = (routing.expert_weight[:, 0] ** 2).sum() + (routing.task_weight[:, 1] ** 2).sum()
    loss.backward()
    for parameter in (g.expert_gate.weight, g.task_gate.weight, g.expert_balance, g.task_balance):
        assert parameter.grad is not None
        assert float(parameter.grad.abs().sum()) > 0


def test_with_one_expert_a_patch_only_the_balance_teaches_the_gate() -> None:
    """The softmax over a single choice is 1 whatever its logit: docs/ablations.md says so of `top-1`."""
    g = gates(k=1).train()
    routing = g(torch.randn(16, 48))
    (routing.expert_weight**2).sum().backward(retain_graph=True)
    assert not g.expert_gate.weight.grad.any()
    assert not g.expert_balance.grad.any()
    routing.balance_loss.backward()
    assert g.expert_gate.weight.grad.any()
