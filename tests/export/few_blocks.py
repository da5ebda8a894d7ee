"""The miniature of the full network as it is exported in tests: with two of the six blocks of its transformer."""

from __future__ import annotations

from full_networks import miniature

from gapmes.model.full_trunk import FullTrunk
from gapmes.model.network import GaPMeS

BLOCKS = 2  # one without a shift of its windows and one with it: the others are like these, and each is traced anew


def little_full_network() -> GaPMeS:
    """`miniature` with so many blocks; DepthSplat, whose transformer is the same, is exported with all."""
    network = miniature()
    assert isinstance(network.trunk, FullTrunk)
    network.trunk.transformer.layers = network.trunk.transformer.layers[:BLOCKS]
    return network
