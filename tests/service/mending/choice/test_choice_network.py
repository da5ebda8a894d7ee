"""The small network against its definition in float64."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gapmes.service.mending.choice.candidates import ABOUT, COUNT, KNOWN
from gapmes.service.mending.choice.network import ROWS, ChoiceNetwork, shipped_choice


def random_network(seed: int, hidden: int = 8) -> ChoiceNetwork:
    rng = np.random.default_rng(seed)
    shapes = [
        (KNOWN, hidden),
        (ABOUT, hidden),
        (COUNT, hidden),
        (hidden, hidden),
        (hidden, hidden),
        hidden,
        hidden,
        COUNT,
    ]
    return ChoiceNetwork(*(rng.normal(0, 0.3, shape).astype(np.float32) for shape in shapes))


def by_definition(network: ChoiceNetwork, known: np.ndarray, about: np.ndarray) -> np.ndarray:
    """(K, N) of known (K, F, N) and about (G, N)."""
    known, about = known.astype(np.float64).transpose(2, 0, 1), about.astype(np.float64).T
    first = np.maximum(known @ network.into + (about @ network.of_pixel)[:, None] + network.of_place, 0)
    second = np.maximum(first @ network.own + (first.mean(axis=1) @ network.shared)[:, None] + network.bias, 0)
    shares = np.exp(second @ network.out.astype(np.float64) + network.prior)
    return (shares / shares.sum(axis=1, keepdims=True)).T


@pytest.mark.parametrize("count", [0, 1, ROWS + 7])
def test_preferences_are_their_definition(count: int) -> None:
    rng, network = np.random.default_rng(3), random_network(1)
    known = rng.normal(size=(COUNT, KNOWN, count)).astype(np.float16)
    about = rng.normal(size=(ABOUT, count)).astype(np.float16)
    found = network.preferences(known, about)
    assert found.shape == (COUNT, count)
    np.testing.assert_allclose(found, by_definition(network, known, about), atol=1e-6)  # found: 2e-7


def test_pixels_do_not_depend_on_each_other() -> None:
    rng, network = np.random.default_rng(4), random_network(2)
    known, about = rng.normal(size=(COUNT, KNOWN, 9)), rng.normal(size=(ABOUT, 9))
    whole = network.preferences(known, about)
    parts = [network.preferences(known[..., n : n + 1], about[:, n : n + 1]) for n in range(9)]
    assert (whole == np.concatenate(parts, axis=1)).all()


def test_large_scores_stay_finite() -> None:
    network = random_network(5)
    known, about = np.full((COUNT, KNOWN, 2), 1e4), np.zeros((ABOUT, 2))
    assert np.isfinite(network.preferences(known, about)).all()


def test_what_is_saved_is_read_again_and_is_the_same_file_each_time(tmp_path: Path) -> None:
    network = random_network(6)
    for name in ("a.npz", "b.npz"):
        network.save(tmp_path / name)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    read = ChoiceNetwork.load(tmp_path / "a.npz")
    assert all((getattr(read, name) == value).all() for name, value in vars(network).items())


def test_the_shipped_network_has_the_shapes_of_what_is_known() -> None:
    network = shipped_choice()
    assert (len(network.into), len(network.of_pixel), len(network.prior)) == (KNOWN, ABOUT, COUNT)
