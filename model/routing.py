"""The two patch gates (Eq. 2-11): Gumbel top-k in training, deterministic top-k in evaluation, hybrid weights."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

TASKS = ("mu", "alpha", "epsilon", "colour")  # k in {mu, alpha, epsilon, c} of Eq. 15


@dataclass(frozen=True)
class Routing:
    """Where M patches go; weights of a patch sum to 1 over its selected experts and over the tasks.

    What an ablated network does not have is None.
    """

    expert_index: Tensor | None  # (M, k) int64, best first
    expert_weight: Tensor | None  # (M, k)
    task_weight: Tensor | None  # (M, 4)
    margin: Tensor | None  # (M,) least gap of the deciding logits, as a share of the largest magnitude of its gate
    balance_loss: Tensor  # scalar, 1 when the load of the experts is even, 0 without experts

    def kept(self, keep: Tensor) -> Routing:
        """The same routes with the weights of left-out patches (keep (M,) = 0) set to 0."""
        factor = keep.unsqueeze(-1)
        return Routing(
            self.expert_index,
            None if self.expert_weight is None else self.expert_weight * factor,
            None if self.task_weight is None else self.task_weight * factor,
            self.margin,
            self.balance_loss,
        )


def top_k_lowest_first(logits: Tensor, k: int) -> Tensor:
    """(M, k) indices of the k largest logits (Eq. 7-8), ties to the lowest index.

    k argmax steps instead of `torch.topk`: argmax returns the first maximum in torch and in onnxruntime, topk does not.
    """
    chosen = []
    for _ in range(k):
        index = logits.argmax(dim=-1, keepdim=True)
        chosen.append(index)
        logits = logits.scatter(-1, index, float("-inf"))
    return torch.cat(chosen, dim=-1)


def decisiveness(logits: Tensor, deciding: int) -> Tensor:
    """(M,) the least of the first `deciding` gaps between sorted logits (M, c), as a share of the row's largest
    magnitude (2 at most; 0 where all are 0): the smaller, the less rounding it takes to change the route."""
    if logits.shape[-1] < 2:
        return torch.full_like(logits[:, 0], 2.0)  # nothing to choose from
    ordered = logits.sort(dim=-1, descending=True).values
    gaps = (ordered[:, :-1] - ordered[:, 1:])[:, :deciding].amin(dim=-1)
    return gaps / logits.abs().amax(dim=-1).clamp(min=1e-30)


def gumbel_noise(like: Tensor, generator: torch.Generator | None = None) -> Tensor:
    """g = -log(-log(u)) of Eq. 5-6, u uniform in the open interval (0, 1)."""
    uniform = torch.rand(like.shape, generator=generator, dtype=like.dtype, device=like.device)
    uniform = uniform.clamp(1e-7, 1 - 1e-7)
    return -torch.log(-torch.log(uniform))


def hybrid_weights(soft: Tensor, balance: Tensor) -> Tensor:
    """Eq. 11 read as l * hard + (1 - l) * soft, hard with the gradient of soft (straight through).

    soft (M, c) sums to 1 per row; hard is one at its first maximum. The result sums to 1 for every l in [0, 1].
    """
    hard = torch.zeros_like(soft).scatter(-1, soft.argmax(dim=-1, keepdim=True), 1.0)
    hard = hard + (soft - soft.detach())
    return balance * hard + (1 - balance) * soft


class Gates(nn.Module):
    """Linear gates on the flattened query (Eq. 3-4); `lambda` of Eq. 11 is a sigmoid, one for each gate.

    `experts` = 0 and `tasks` = False leave the respective gate out.
    """

    def __init__(self, query_size: int, experts: int, top_k: int, temperature: float, *, tasks: bool = True) -> None:
        super().__init__()
        self.top_k = top_k
        self.temperature = temperature
        self.noise_scale = 1.0  # 1 is the paper's Gumbel noise; the recipe anneals it to 0
        self.expert_gate = nn.Linear(query_size, experts) if experts else None
        self.task_gate = nn.Linear(query_size, len(TASKS)) if tasks else None
        self.expert_balance = nn.Parameter(torch.zeros(())) if experts else None
        self.task_balance = nn.Parameter(torch.zeros(())) if tasks else None

    def forward(self, query: Tensor) -> Routing:
        """query (M, query_size) -> `Routing`; noise only while training (Eq. 5-6)."""
        index = weight = task_weight = None
        margins = []
        balance_loss = query.new_zeros(())
        if self.expert_gate is not None and self.expert_balance is not None:
            clean = self.expert_gate(query)
            logits = self._perturbed(clean)
            index = top_k_lowest_first(logits, self.top_k)
            soft = self.softmax(logits.gather(-1, index))  # Eq. 10 over S_i
            weight = hybrid_weights(soft, torch.sigmoid(self.expert_balance))
            balance_loss = _balance_loss(clean, index)
            margins.append(decisiveness(clean, self.top_k))
        if self.task_gate is not None and self.task_balance is not None:
            clean = self.task_gate(query)
            soft = self.softmax(self._perturbed(clean))  # Eq. 10 over all tasks
            margins.append(decisiveness(clean, 1))
            task_weight = hybrid_weights(soft, torch.sigmoid(self.task_balance))
        margin = torch.stack(margins).amin(dim=0) if margins else None
        return Routing(index, weight, task_weight, margin, balance_loss)

    def _perturbed(self, logits: Tensor) -> Tensor:
        """Eq. 5-6."""
        if self.training and self.noise_scale > 0:
            return logits + self.noise_scale * gumbel_noise(logits)
        return logits

    def softmax(self, logits: Tensor) -> Tensor:
        """softmax(logits / tau); the largest is taken off first, so that dividing cannot overflow."""
        return torch.softmax((logits - logits.amax(-1, keepdim=True)) / self.temperature, dim=-1)


def _balance_loss(logits: Tensor, index: Tensor) -> Tensor:
    """N_e * sum_e (share of patches sent to e) * (mean probability of e): 1 when even (Fedus et al. 2021)."""
    experts = logits.shape[-1]
    share = torch.zeros_like(logits).scatter(-1, index, 1.0).mean(0) / index.shape[-1]
    return experts * (share * torch.softmax(logits, dim=-1).mean(0)).sum()
