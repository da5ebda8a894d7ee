"""A reader that opens a scene's file while another process deletes or replaces it is told that it is gone."""

from __future__ import annotations

import fcntl
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from store_folder import document

from gapmes.service.errors import SceneNotFound
from gapmes.service.scenes.scene_files import SceneFiles
from gapmes.service.scenes.store import SceneStore

A = "a" * 32


def replaced(folder: Path) -> None:
    (folder / "scene.ply").rename(folder / "before")
    (folder / "scene.ply").write_bytes(b"another")


@pytest.mark.parametrize("meanwhile", [shutil.rmtree, replaced])
def test_what_goes_before_it_is_locked_is_gone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, meanwhile: Callable[[Path], object]
) -> None:
    SceneStore(tmp_path).put(A, b"ply", document(A))
    lock = fcntl.flock

    def late(handle: int, how: int) -> None:
        meanwhile(tmp_path / A)
        lock(handle, how)

    monkeypatch.setattr(fcntl, "flock", late)
    with pytest.raises(SceneNotFound, match=A), SceneFiles(tmp_path).keeping(A):
        pytest.fail("it is kept")
