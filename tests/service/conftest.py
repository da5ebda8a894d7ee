"""Fixtures of the service's tests: the stand-in network, photographs of a plane, and a folder of photographs."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from plane_scene import PlaneScene
from plane_views import plane_views, with_wrong_patch
from standin_model import write_standin

from gapmes.service.network.engine import Engine
from gapmes.service.photographs.images import FittedView


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


@pytest.fixture(scope="module")
def views() -> list[FittedView]:
    """Three photographs of a textured plane as the network's inputs."""
    return plane_views()


@pytest.fixture(scope="module")
def spoiled(views: list[FittedView]) -> np.ndarray:
    """The plane's depths, (V, H, W), but for a patch of the first view that is a fifth too far."""
    return with_wrong_patch(views, 1.2)


@pytest.fixture
def scene_dir(tmp_path: Path) -> Path:
    """Four photographs of noise, side by side, with a cameras.json."""
    (tmp_path / "scene" / "images").mkdir(parents=True)
    views = []
    for index in range(4):
        name = f"images/{index:03d}.png"
        pixels = np.random.default_rng(index).integers(0, 256, (48, 64, 3), dtype=np.uint8)
        Image.fromarray(pixels).save(tmp_path / "scene" / name)
        pose = np.eye(4)
        pose[0, 3] = 0.2 * index
        views.append(
            {
                "image": name,
                "width": 64,
                "height": 48,
                "fx": 60.0,
                "fy": 60.0,
                "cx": 32.0,
                "cy": 24.0,
                "c2w": pose.tolist(),
            }
        )
    (tmp_path / "scene" / "cameras.json").write_text(json.dumps({"near": 1.0, "far": 10.0, "views": views}))
    return tmp_path / "scene"
