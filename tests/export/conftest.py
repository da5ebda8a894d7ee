"""Exports that several tests share, each made once for small pictures: the shipped network and miniatures of the full
one and of DepthSplat."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import onnx
import pytest
from few_blocks import little_full_network
from few_pieces import few_pieces
from filelock import FileLock
from miniature_depthsplat import miniature_depthsplat

from gapmes.export.build import export_graph
from gapmes.export.metadata import add_metadata, contract_metadata
from gapmes.model.checkpoint import WEIGHTS_LICENCE, load_checkpoint, shipped_checkpoint
from gapmes.model.network import GaPMeS
from gapmes.model.weights_file import file_sha256

SIZE = 64
OBLONG = (48, 80)  # height and width


@pytest.fixture(scope="session")
def checkpoint() -> Path:
    return shipped_checkpoint("tiny")


@pytest.fixture
def network(checkpoint: Path) -> GaPMeS:
    return load_checkpoint(checkpoint)


def _once(name: str, made: Callable[[], onnx.ModelProto], temporary: pytest.TempPathFactory) -> onnx.ModelProto:
    """What `made` gives, which takes minutes: one of the processes of the tests makes it, others read its file."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        return made()
    path = temporary.getbasetemp().parent / name
    with FileLock(f"{path}.lock"):
        if not path.exists():
            onnx.save(made(), path)
    return onnx.load(path)


@pytest.fixture(scope="session")
def small_graph(checkpoint: Path, tmp_path_factory: pytest.TempPathFactory) -> onnx.ModelProto:
    """The shipped network for 64 x 64 pixels, with metadata; copy it before changing it."""
    return _once("small.onnx", lambda: _small_graph(checkpoint), tmp_path_factory)


def _small_graph(checkpoint: Path) -> onnx.ModelProto:
    network = load_checkpoint(checkpoint)
    with few_pieces():
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
def miniature_graph(tmp_path_factory: pytest.TempPathFactory) -> onnx.ModelProto:
    """The full trunk with miniature ViTs (`little_full_network`) for 48 x 80 pixels: in pictures that are not square no
    height passes for a width. Copy it before changing it."""
    with few_pieces():
        return _once("miniature.onnx", lambda: export_graph(little_full_network(), *OBLONG), tmp_path_factory)


@pytest.fixture(scope="session")
def depthsplat_graph(tmp_path_factory: pytest.TempPathFactory) -> onnx.ModelProto:
    """DepthSplat with a miniature ViT, two scales, for 64 x 64 pixels; copy it before changing it."""
    return _once("depthsplat.onnx", lambda: export_graph(miniature_depthsplat(2, 4), SIZE, SIZE), tmp_path_factory)
