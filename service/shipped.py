"""Where the files lie that the package carries: the default network and the sample scene."""

from __future__ import annotations

from pathlib import Path

_ASSETS = Path(__file__).parent / "assets"


def shipped_model() -> Path:
    """The exported `tiny` network."""
    return _ASSETS / "tiny.onnx"


def sample_folder() -> Path:
    """The sample scene: images/ and cameras.json."""
    return _ASSETS / "sample"
