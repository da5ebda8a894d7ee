"""A file with endlessly nested weights is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from gapmes.model.pretrained.files import DEEPEST, read_tensors
from gapmes.model.weights_file import CheckpointError


def test_a_file_that_contains_itself_is_refused(tmp_path: Path) -> None:
    endless: dict[str, object] = {}
    endless["model"] = endless
    torch.save(endless, tmp_path / "endless.pth")
    with pytest.raises(CheckpointError, match=rf"more than {DEEPEST} deep: model\.model"):
        read_tensors(tmp_path / "endless.pth")
