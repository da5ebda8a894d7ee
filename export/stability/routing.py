"""Gates at their extremes: ties, near ties, huge logits, lambda; and experts on few patches beside all on all."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from mpmath import mp

from gapmes.model.experts import ExpertGroup
from gapmes.model.routing import Gates, Routing, decisiveness, hybrid_weights, top_k_lowest_first

from ..routes import AMBIGUOUS_GAP
from . import naive
from .row import Row, larger


def rows() -> Iterator[Row]:
    yield from (ties(), near_ties(), huge_logits(), balance(), sparse_experts())


def ties() -> Row:
    wrong = plain = total = 0
    for experts in range(1, 65):
        for k in {1, 2, experts} & set(range(1, experts + 1)):
            logits = torch.zeros(1, experts)
            wrong += int(top_k_lowest_first(logits, k)[0].tolist() != list(range(k)))
            plain += int(torch.topk(logits, k).indices[0].tolist() != list(range(k)))
            total += 1
    return Row(
        "R1",
        "all logits equal",
        "1 to 64 experts, k = 1, 2, all",
        "the lowest indices",
        "share of cases",
        wrong / total,
        0.0,
        plain / total,
        "torch.topk",
    )


def near_ties() -> Row:
    """float32 logits against the float64 ones they round; routes may differ only where the margin is small."""
    rng, missed, flips, total = np.random.default_rng(2), 0, 0, 0
    for gap in (0.0, 1e-8, 1e-7, 1e-6, 1e-5, 1e-3, 1e-2):
        wide = rng.normal(0, 1, (2000, 6))
        wide[:, 1] = wide[:, 0] + gap * np.abs(wide).max(axis=1)
        narrow = torch.from_numpy(wide.astype(np.float32))
        differs = (top_k_lowest_first(narrow, 2) != top_k_lowest_first(torch.from_numpy(wide), 2)).any(-1)
        decided = decisiveness(narrow, 2) > AMBIGUOUS_GAP
        missed, flips, total = missed + int((differs & decided).sum()), flips + int(differs.sum()), total + len(wide)
    return Row(
        "R2",
        "routes that rounding changes unannounced",
        "gaps of 0 to 1e-2",
        "float64",
        "share of patches",
        missed / total,
        0.0,
        flips / total,
        "no margin told",
    )


def huge_logits() -> Row:
    mp.dps = 60
    rng, worst, plain = np.random.default_rng(3), 0.0, 0.0
    for scale in (1.0, 1e4, 1e30, 1e38):
        for temperature in (1e-3, 0.8, 1e3):
            logits = (scale * rng.uniform(-3, 3, (20, 4))).astype(np.float32)
            gates = Gates(4, 0, 1, temperature)
            soft = gates.softmax(torch.from_numpy(logits)).detach().numpy()
            simple = naive.softmax(logits, temperature)
            for row, ours, other in zip(logits, soft, simple, strict=True):
                tau = mp.mpf(temperature)
                powers = [mp.exp((mp.mpf(float(v)) - mp.mpf(float(row.max()))) / tau) for v in row]
                exact = np.array([float(p / mp.fsum(powers)) for p in powers])
                worst = larger(worst, float(np.abs(ours - exact).max()))
                plain = larger(plain, float(np.abs(other - exact).max()))
    return Row(
        "R3",
        "softmax of huge logits",
        "1 to 3e38, temperature 1e-3 to 1e3",
        "60 digits",
        "weight",
        worst,
        2e-7,
        plain,
        "exp(logits / tau)",
    )


def balance() -> Row:
    worst = 0.0
    soft = torch.softmax(torch.randn(500, 6, generator=torch.Generator().manual_seed(4)), -1)
    for value in (0.0, 1e-6, 0.3, 1 - 1e-6, 1.0):
        balance = torch.tensor(value)
        weights = hybrid_weights(soft, balance).double()
        hard = (soft == soft.amax(-1, keepdim=True)).double()
        exact = balance.double() * hard + (1 - balance.double()) * soft.double()
        worst = larger(worst, float((weights - exact).abs().max()), float((weights.sum(-1) - 1).abs().max()))
    return Row("R4", "mixing weights, and their sum", "lambda 0 to 1", "float64, 1", "weight", worst, 3e-7)


def sparse_experts() -> Row:
    torch.manual_seed(5)
    group, worst = ExpertGroup(6, 8).eval(), 0.0
    for patches in (1, 7, 64):
        for skew in (0.0, 100.0):
            logits = torch.randn(patches, 6)
            logits[:, 2] += skew
            index = top_k_lowest_first(logits, 2)
            weight = hybrid_weights(torch.softmax(logits.gather(-1, index), -1), torch.tensor(0.4))
            routing = Routing(index, weight, None, None, torch.zeros(()))
            x = torch.randn(patches, 24, 4, 4)
            with torch.no_grad():
                sparse, dense = group(x, routing), group.dense(x, routing)
            worst = larger(worst, float((sparse - dense).abs().max() / dense.abs().max()))
    return Row(
        "R5",
        "experts on their patches alone",
        "1 to 64 patches, even and all to one",
        "every expert on all",
        "of the largest",
        worst,
        2e-6,
    )
