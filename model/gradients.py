"""Where no gradient is wanted."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext

import torch


def no_gradient(wanted: bool = True) -> AbstractContextManager[object]:
    """`torch.no_grad()`, or nothing where gradients are off already, or not `wanted`. An export records every change of
    that state, splits the graph there and joins it again, although it happens without gradients throughout."""
    return torch.no_grad() if wanted and torch.is_grad_enabled() else nullcontext()
