"""A smaller graph of the same network, for tests in which its size does not matter."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest


@contextmanager
def few_pieces() -> Iterator[None]:
    """Matching goes through rows and planes in one piece instead of eight: fewer nodes, which an export traces one by
    one, for minutes. The network computes the same; that all pieces export is tested with the shipped file."""
    with pytest.MonkeyPatch.context() as patch:
        for module in ("cost_volume", "evidence"):
            patch.setattr(f"gapmes.model.{module}.SWEEP_PIECES", 1)
        yield
