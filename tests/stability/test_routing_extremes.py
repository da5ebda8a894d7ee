"""Routing at its limits: ties in both runtimes, gaps of single roundings, huge logits, mixing weights, idle experts."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper
from small_networks import scene, tiny

from gapmes.export.routes import AMBIGUOUS_GAP
from gapmes.model.config import preset
from gapmes.model.experts import ExpertGroup
from gapmes.model.heads import Heads
from gapmes.model.routing import Gates, Routing, hybrid_weights, top_k_lowest_first

EXPERTS, K = 6, 2


def onnx_top_k(experts: int, k: int) -> onnxruntime.InferenceSession:
    """The k argmax steps as ONNX operators, written by hand."""
    lowest = numpy_helper.from_array(np.array([[-np.inf]], np.float32), "lowest")
    nodes, row, chosen = [], "logits", []
    for step in range(k):
        nodes.append(helper.make_node("ArgMax", [row], [f"best{step}"], axis=-1, keepdims=1))
        nodes.append(helper.make_node("ScatterElements", [row, f"best{step}", "lowest"], [f"row{step}"], axis=-1))
        row = f"row{step}"
        chosen.append(f"best{step}")
    nodes.append(helper.make_node("Concat", chosen, ["index"], axis=-1))
    given = helper.make_tensor_value_info("logits", TensorProto.FLOAT, [1, experts])
    found = helper.make_tensor_value_info("index", TensorProto.INT64, [1, k])
    graph = helper.make_graph(nodes, "top_k", [given], [found], [lowest])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
    onnx.checker.check_model(model)
    return onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])


@pytest.mark.case("R1")
def test_ties_of_every_width_take_the_lowest_indices() -> None:
    for experts in range(1, 65):
        for dtype in (torch.float32, torch.float64):
            index = top_k_lowest_first(torch.full((1, experts), 0.3, dtype=dtype), experts)
            assert index.tolist() == [list(range(experts))]  # the first k of it are the top k


@pytest.mark.case("R1")
@pytest.mark.parametrize("experts", [1, 2, 6, 17, 64])
def test_onnxruntime_breaks_ties_alike(experts: int) -> None:
    session = onnx_top_k(experts, experts)
    rng = np.random.default_rng(experts)
    for logits in (np.zeros(experts), np.full(experts, -3e38), rng.integers(-1, 2, experts)):
        row = logits.astype(np.float32)[None]
        (index,) = session.run(None, {"logits": row})
        assert index.tolist() == top_k_lowest_first(torch.from_numpy(row), experts).tolist()
        assert index[0].tolist() == sorted(range(experts), key=lambda i: (-row[0, i], i))


def gates_of(weight: torch.Tensor, bias: torch.Tensor, k: int = K, tau: float = 0.8) -> Gates:
    """Gates whose expert logits are weight @ query + bias and whose weights are the soft ones (lambda = 0)."""
    gates = Gates(weight.shape[1], weight.shape[0], k, tau, tasks=False).eval()
    assert gates.expert_gate is not None
    with torch.no_grad():
        gates.expert_gate.weight.copy_(weight)
        gates.expert_gate.bias.copy_(bias)
        gates.expert_balance.fill_(-200.0)  # its sigmoid, lambda, is exactly 0 in float32
    return gates


@pytest.mark.case("R2")
def test_near_ties_route_as_in_float64_or_are_told_apart_as_ambiguous() -> None:
    """The deciding gaps run from 0 and one unit in the last place to 1e-2; 42 products of order 1 blur each logit."""
    generator = torch.Generator().manual_seed(0)
    weight = torch.cat([torch.randn(EXPERTS, 42, generator=generator) / 6.5, torch.eye(EXPERTS)], dim=1)
    ulp = 2.0**-23
    flipped = ambiguous = total = 0
    for gap in (0.0, ulp, -ulp, 1e-7, 1e-6, 1e-5, 3e-5, 1e-4, 1e-3, 1e-2):
        query = torch.randn(400, 48, generator=generator)
        blurred = query[:, :42].double() @ weight[:, :42].double().T
        wanted = torch.tensor([1.0 + gap, 1.0, 1.0 - gap, -1.0, -2.0, -3.0], dtype=torch.float64)
        turns = torch.randint(EXPERTS, (400,), generator=generator)
        wanted = torch.stack([wanted.roll(int(turn)) for turn in turns])
        query[:, 42:] = (wanted - blurred).float()
        logits = query.double() @ weight.double().T  # of the rounded numbers, exact to 1e-15
        routing = gates_of(weight, torch.zeros(EXPERTS))(query)
        exact = torch.from_numpy(np.argsort(-logits.numpy(), axis=1, kind="stable")[:, :K].copy())
        ordered = logits.sort(dim=1, descending=True).values
        decided = (ordered[:, :K] - ordered[:, 1 : K + 1]).amin(1) > AMBIGUOUS_GAP * logits.abs().amax(1)
        same = (routing.expert_index == exact).all(1)
        assert same[decided].all()
        told = routing.margin <= AMBIGUOUS_GAP * 1.1  # the margin itself is rounded to about 1e-7
        assert told[~decided].all()
        assert told[~same].all()
        flipped, ambiguous, total = flipped + int((~same).sum()), ambiguous + int(told.sum()), total + len(same)
    assert 0 < flipped < ambiguous < total  # 676, 2800 and 4000 here


@pytest.mark.case("R3")
@pytest.mark.parametrize("tau", [1e-3, 0.8, 1.0, 30.0, 1e3])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 88.0, 1e4, 1e30, 3e38])
def test_soft_weights_in_sixty_digits(scale: float, tau: float) -> None:
    rng = np.random.default_rng(3)
    worst = 0.0
    for _ in range(10):
        bias = torch.from_numpy((rng.uniform(-1, 1, EXPERTS) * scale).astype(np.float32))
        routing = gates_of(torch.zeros(EXPERTS, 8), bias, EXPERTS, tau)(torch.zeros(1, 8))
        with mp.workdps(60):
            terms = [mp.exp((mp.mpf(float(v)) - mp.mpf(float(bias.max()))) / mp.mpf(tau)) for v in bias]
            expected = [float(term / mp.fsum(terms)) for term in terms]
        found = torch.zeros(EXPERTS).scatter(0, routing.expert_index[0], routing.expert_weight[0].detach()).double()
        worst = max(worst, float((found - torch.tensor(expected, dtype=torch.float64)).abs().max()))
    assert worst < 2e-7  # measured 1.6e-7


@pytest.mark.case("R3")
@pytest.mark.parametrize("tau", [1e-3, 0.1, 0.8, 10.0, 1e3])
def test_soft_weights_move_by_at_most_the_change_of_a_logit_over_twice_tau(tau: float) -> None:
    generator = torch.Generator().manual_seed(4)
    logits = torch.randn(500, EXPERTS, generator=generator) * tau
    change = 0.2 * tau * (2 * torch.rand(500, EXPERTS, generator=generator) - 1)
    gates = gates_of(torch.eye(EXPERTS), torch.zeros(EXPERTS), EXPERTS, tau)
    weights = []
    for query in (logits, logits + change):
        routing = gates(query)
        weights.append(torch.zeros_like(query).scatter(1, routing.expert_index, routing.expert_weight))
    moved = (weights[0] - weights[1]).abs().amax(1)
    # the sum and each weight are rounded, as in the comparison with sixty digits
    assert (moved <= (logits + change - logits).abs().amax(1) / (2 * tau) + 4e-7).all()


@pytest.mark.case("R4")
@pytest.mark.parametrize("balance", [-1.0, 0.0, 0.25, 1.0, 1.5, 2.0])
def test_mixed_weights_are_those_of_the_formula(balance: float) -> None:
    """Eq. 11 is read as l * hard + (1 - l) * soft alone: its sum is 1 for any l, also outside [0, 1]."""
    soft = torch.softmax(torch.randn(200, 4, generator=torch.Generator().manual_seed(0)), -1)
    weights = hybrid_weights(soft, torch.tensor(balance)).double()
    exact = soft.double()
    hard = torch.nn.functional.one_hot(exact.argmax(-1), 4).double()
    expected = balance * hard + (1 - balance) * exact
    assert (weights - expected).abs().max() < 2e-7 * max(1.0, abs(balance) + abs(1 - balance))
    assert (weights.sum(-1) - 1).abs().max() < 3e-7 * max(1.0, abs(balance) + abs(1 - balance))


@pytest.mark.case("R4")
@pytest.mark.parametrize("parameter", [-3e38, -100.0, -1.0, 0.0, 2.0, 100.0, 3e38, float("inf"), float("nan")])
def test_the_gates_keep_lambda_between_zero_and_one(parameter: float) -> None:
    """Lambda is a sigmoid and cannot leave [0, 1]; one that is no number shows in the weights, which are refused."""
    gates = gates_of(torch.eye(EXPERTS), torch.zeros(EXPERTS))
    with torch.no_grad():
        gates.expert_balance.fill_(parameter)
    weight = gates(torch.randn(50, EXPERTS, generator=torch.Generator().manual_seed(1))).expert_weight
    if np.isnan(parameter):
        assert torch.isnan(weight).all()
        return
    assert ((weight >= 0) & (weight <= 1 + 2e-7)).all()
    assert (weight.sum(-1) - 1).abs().max() < 2e-7


@pytest.mark.case("R5")
@pytest.mark.parametrize("chosen", [(0, 1), (5, 0), (2, 3)])
def test_sparse_experts_equal_dense_ones_in_float64_when_all_patches_choose_the_same(chosen: tuple[int, int]) -> None:
    """Four experts are idle; one of the two that are not gets a weight of exactly 0 for half of the patches."""
    torch.manual_seed(0)
    group, patches = ExpertGroup(EXPERTS, 8).eval(), torch.randn(30, 24, 4, 4)
    weight = torch.tensor([[0.7, 0.3], [1.0, 0.0]]).repeat(15, 1)
    index = torch.tensor([chosen]).expand(30, 2)
    routing = Routing(index, weight, None, None, torch.zeros(()))
    order = torch.randperm(30)
    moved = Routing(index, weight[order], None, None, torch.zeros(()))
    with torch.no_grad():
        sparse, permuted = group(patches, routing), group(patches[order], moved)
        halves = torch.cat([group(patches[part], routing_part(routing, part)) for part in (range(7), range(7, 30))])
        exact = group.double().dense(patches.double(), Routing(index, weight.double(), None, None, torch.zeros(())))
    largest = float(exact.abs().max())  # measured 2.9e-7 of it
    assert (sparse - exact).abs().max() < 2e-6 * largest
    assert (permuted - exact[order]).abs().max() < 2e-6 * largest
    assert (halves - exact).abs().max() < 2e-6 * largest


def routing_part(routing: Routing, rows: range) -> Routing:
    return Routing(routing.expert_index[list(rows)], routing.expert_weight[list(rows)], None, None, torch.zeros(()))


@pytest.mark.case("R5")
def test_no_patch_at_all_is_an_empty_result() -> None:
    torch.manual_seed(0)
    group = ExpertGroup(EXPERTS, 8).eval()
    nobody = Routing(torch.zeros(0, 2, dtype=torch.long), torch.zeros(0, 2), None, None, torch.zeros(()))
    assert group(torch.zeros(0, 24, 4, 4), nobody).shape == (0, 24, 4, 4)


@pytest.mark.case("R5")
def test_a_task_that_gets_no_weight_reads_the_plain_features() -> None:
    """Eq. 15 is used in residual form, so that a task without patches has the shared map itself and no holes."""
    network = tiny()
    gates = network.mixture.gates
    with torch.no_grad():
        gates.task_gate.weight.zero_()
        gates.task_gate.bias.copy_(torch.tensor([100.0, 0, 0, 0]))  # all patches to the first task
        streams = {name: torch.randn(1, c, 16, 16) for name, c in (("texture", 64), ("semantic", 96), ("depth", 114))}
        tasks = network.mixture(streams, streams["texture"], torch.ones(16))
        prediction = network(*scene(1, 2, 64))
    assert tasks.routing.task_weight.tolist() == [[1.0, 0, 0, 0]] * 16
    assert torch.equal(tasks.maps[0], 2 * tasks.maps[1])
    assert torch.equal(tasks.maps[1], tasks.maps[2])
    assert torch.isfinite(tasks.maps[3]).all()
    assert all(torch.isfinite(value).all() for value in vars(prediction.gaussians).values())


@pytest.mark.case("R5")
def test_empty_maps_give_the_constant_of_each_head() -> None:
    """Zeros everywhere: what is left is the biases through the activations, the same for every patch."""
    torch.manual_seed(0)
    config = preset("tiny")
    heads = Heads(config, 16).eval()
    with torch.no_grad():
        out = heads([torch.zeros(1, 16, 8, 8)] * 4, torch.zeros(1, config.refine_channels, 16, 16))
    for value in vars(out).values():
        assert torch.isfinite(value).all()
        inner = value[:, :, 8:-8, 8:-8]  # a convolution sees zeros beyond the border
        tiles = inner.unfold(2, 4, 4).unfold(3, 4, 4)
        assert (tiles - tiles[:, :, :1, :1]).abs().max() < 1e-6
