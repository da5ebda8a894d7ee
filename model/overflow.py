"""Detection of overflow: the first layer whose result is not finite although all weights are."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from .allocation import lacks_memory
from .weights_file import CheckpointError

PROBE_SIDE = 64  # px: every network takes it, and what overflows there does so at any size
_FAILURES = (ArithmeticError, IndexError, RuntimeError, ValueError)  # of a network that computes


def refuse_overflow(path: Path, network: nn.Module) -> None:
    """Raises `CheckpointError` for a file whose `network` overflows on two small pictures of noise, naming the layer
    and the largest weight, or cannot compute them, for lack of memory too; it has to be in evaluation mode."""
    try:
        found = overflow(network, lambda: network(*_probe()))
    except _FAILURES as error:
        told = next(iter(str(error).splitlines()), "")[:200]
        if lacks_memory(error):
            raise CheckpointError(
                f"{path}: not enough memory to compute two pictures of {PROBE_SIDE} px with its network ({told}): take "
                "a machine with more memory, or a smaller preset"
            ) from error
        raise CheckpointError(
            f"{path}: its network cannot compute two pictures of {PROBE_SIDE} px ({type(error).__name__}: {told}); "
            "sizes in its configuration do not go together: take the one that the weights were trained with"
        ) from error
    if found:
        raise CheckpointError(
            f"{path}: {found}; the file is damaged or was saved from a diverged run: take another file"
        )


def overflow(network: nn.Module, compute: Callable[[], object]) -> str:
    """A message that names the first layer of `network` with a non-finite result in `compute`, and the largest weight;
    empty where the result of `compute` is finite. An error without a non-finite result before it is re-raised.

    Layers are watched only in a second computation, where the first is not finite: looking at all their results takes
    a third of the time of a small network. Where `compute` draws random numbers, the second may be finite."""
    with torch.no_grad():
        with suppress(*_FAILURES):
            if _finite(compute()):
                return ""
        with _first_overflow(network) as layers:
            try:
                if _finite(compute()):
                    return ""
            except _FAILURES:
                if not layers:
                    raise
    name, largest = _largest_weight(network)
    where = f"layer {layers[0]}" if layers else "the network"
    return f"{where} overflows: it gives numbers that are not finite; the largest weight is {largest:.3g}, in {name}"


@contextmanager
def _first_overflow(network: nn.Module) -> Iterator[list[str]]:
    """A list that receives the name of the first module, in order of computation, with a non-finite result."""
    found: list[str] = []

    def watched(name: str) -> Callable[[nn.Module, object, object], None]:
        return lambda _module, _given, result: None if found or _finite(result) else found.append(name)

    hooks = [module.register_forward_hook(watched(name)) for name, module in network.named_modules() if name]
    try:
        yield found
    finally:
        for hook in hooks:
            hook.remove()


def _finite(value: Any) -> bool:
    """Whether all numbers in nested tensors, containers and dataclasses are finite."""
    if isinstance(value, Tensor):
        return bool(torch.isfinite(value).all())
    if isinstance(value, Mapping):
        return all(map(_finite, value.values()))
    if isinstance(value, list | tuple):
        return all(map(_finite, value))
    if is_dataclass(value):
        return all(_finite(getattr(value, field.name)) for field in fields(value))
    return True


def _largest_weight(network: nn.Module) -> tuple[str, float]:
    sizes = {name: float(value.detach().abs().max()) for name, value in network.named_parameters() if value.numel()}
    name = max(sizes, key=lambda key: sizes[key])
    return name, sizes[name]


def _probe() -> tuple[Tensor, ...]:
    """Images, intrinsics, poses, near and far of two views."""
    images = torch.rand(1, 2, 3, PROBE_SIDE, PROBE_SIDE, generator=torch.Generator().manual_seed(0))
    intrinsics = torch.tensor([[0.9, 0, 0.5], [0, 0.9, 0.5], [0, 0, 1]]).repeat(1, 2, 1, 1)
    poses = torch.eye(4).repeat(1, 2, 1, 1)
    poses[:, 1, 0, 3] = 0.12
    return images, intrinsics, poses, torch.tensor([[1.0, 20.0]])
