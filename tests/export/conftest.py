"""Exports that several tests share, each made once at 64 x 64 pixels: the shipped network and a small full one."""

from __future__ import annotations

from pathlib import Path

import onnx
import pytest
from full_networks import miniature

from gapmes.export.build import export_graph
from gapmes.export.metadata import add_metadata, contract_metadata
from gapmes.model.checkpoint import WEIGHTS_LICENCE, file_sha256, load_checkpoint, shipped_checkpoint
from gapmes.model.network import GaPMeS

SIZE = 64


@pytest.fixture(scope="session")
def checkpoint() -> Path:
    return shipped_checkpoint("tiny")


@pytest.fixture
def network(checkpoint: Path) -> GaPMeS:
    return load_checkpoint(checkpoint)


@pytest.fixture(scope="session")
def small_graph(checkpoint: Path) -> onnx.ModelProto:
    """The shipped network for 64 x 64 pixels, with metadata; copy it before changing it."""
    network = load_checkpoint(checkpoint)
    model = export_graph(network, SIZE, SIZE)
    metadata = contract_metadata(
        network,
        height=SIZE,
        width=SIZE,
        weights_sha256=file_sha256(checkpoint),
        licence=WEIGHTS_LICENCE,
        precision="fp32",
    )
    add_metadata(model, metadata)
    return model


@pytest.fixture(scope="session")
def miniature_graph() -> onnx.ModelProto:
    """The full trunk with miniature ViTs (`full_networks.miniature`) for 64 x 64 pixels; copy it before changing it."""
    return export_graph(miniature(), SIZE, SIZE)
