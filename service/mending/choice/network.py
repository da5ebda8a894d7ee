"""The small network that scores depth candidates: its weights and its inference."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...process.disk import replacing

F32 = NDArray[np.float32]

ROWS = 4096  # pixels per batch: float32 copies of all features at once would double the memory


@dataclass(frozen=True, eq=False)
class ChoiceNetwork:
    """Weights, named and shaped as `kernels.choose_rows` has them."""

    into: F32
    of_pixel: F32
    of_place: F32
    own: F32
    shared: F32
    bias: F32
    out: F32
    prior: F32

    @staticmethod
    def load(path: Path) -> ChoiceNetwork:
        """Read what `save` wrote."""
        with np.load(path) as file:
            return ChoiceNetwork(**{field.name: file[field.name] for field in fields(ChoiceNetwork)})

    def save(self, path: Path) -> None:
        """Write an .npz, atomically; equal weights give equal bytes."""
        with replacing(path) as part, part.open("wb") as file:
            np.savez(file, **{field.name: getattr(self, field.name) for field in fields(self)})

    def preferences(self, known: NDArray[np.floating], about: NDArray[np.floating]) -> F32:
        """(K, N) softmax over the K candidates of each of N pixels, from candidate features `known` (K, F, N) and pixel
        features `about` (G, N)."""
        from .kernels import choose_rows

        scores = np.empty((known.shape[2], len(known)), np.float32)
        weights = [np.ascontiguousarray(getattr(self, field.name), np.float32) for field in fields(self)]
        for start in range(0, len(scores), ROWS):
            part = slice(start, start + ROWS)
            of_candidates = np.ascontiguousarray(known[..., part].transpose(2, 0, 1), np.float32)
            choose_rows(of_candidates, np.ascontiguousarray(about[:, part].T, np.float32), *weights, scores[part])
        scores -= scores.max(axis=1, keepdims=True)
        np.exp(scores, out=scores)
        scores /= scores.sum(axis=1, keepdims=True)
        return scores.T


@cache
def shipped_choice() -> ChoiceNetwork:
    """The network that the package carries."""
    return ChoiceNetwork.load(Path(__file__).parent / "choice.npz")
