"""Fixtures of the service's tests: the stand-in network, and textured photographs of a plane with their cameras."""

from pathlib import Path

import numpy as np
import pytest
from plane_scene import PlaneScene
from standin_model import write_standin

from gapmes.service.engine import Engine


@pytest.fixture(scope="session")
def standin_model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An ONNX file under the contract of the real one, see standin_model.py."""
    return write_standin(tmp_path_factory.mktemp("model") / "standin.onnx")


@pytest.fixture(scope="session")
def engine(standin_model: Path) -> Engine:
    return Engine(standin_model, threads=1)


@pytest.fixture(scope="session")
def plane_scene() -> PlaneScene:
    """Three photographs of a textured plane."""
    return PlaneScene.make(np.random.default_rng(7))
