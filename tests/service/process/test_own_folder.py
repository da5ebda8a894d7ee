"""Temporary folders: those left by a killed process are removed, those in use stay."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from gapmes.service.process.own_folder import YOUNG_S, in_use, own_folder

KILLED = """
import os, signal, sys
from pathlib import Path
from gapmes.service.process.own_folder import own_folder
with own_folder("gapmes-x-", Path(sys.argv[1])) as folder:
    (folder / "half").write_text("a film")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def aged(folder: Path) -> None:
    then = folder.stat().st_mtime - 2 * YOUNG_S
    os.utime(folder, (then, then))


@pytest.fixture
def left(tmp_path: Path) -> Path:
    """The folder of a killed process."""
    subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], check=False)
    [folder] = tmp_path.iterdir()
    assert (folder / "half").is_file()
    return folder


def test_it_goes_with_the_block(tmp_path: Path) -> None:
    with own_folder("gapmes-x-", tmp_path) as folder:
        assert list(tmp_path.iterdir()) == [folder]
    assert list(tmp_path.iterdir()) == []


def test_what_a_kill_has_left_goes_when_the_next_is_made(tmp_path: Path, left: Path) -> None:
    (tmp_path / "gapmes-other").mkdir()
    aged(tmp_path / "gapmes-other")
    with own_folder("gapmes-x-", tmp_path):
        assert left.exists()  # somebody may be about to lock it
    aged(left)
    with own_folder("gapmes-x-", tmp_path) as folder:
        assert set(tmp_path.iterdir()) == {folder, tmp_path / "gapmes-other"}


def test_what_is_in_use_stays(tmp_path: Path, left: Path) -> None:
    """By who made it, and by a worker whose watcher was killed."""
    with own_folder("gapmes-x-", tmp_path) as first:
        for folder in (first, left):
            aged(folder)
        with in_use(left), own_folder("gapmes-x-", tmp_path):
            assert first.exists()
            assert left.exists()


def test_what_another_user_has_put_there_is_not_touched(
    tmp_path: Path, left: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Everybody may write into /tmp, and a lock there might be a link to where a file would then be made."""
    (left / ".lock").unlink()
    (left / ".lock").symlink_to(tmp_path / "made")
    aged(left)
    monkeypatch.setattr(os, "geteuid", lambda: left.stat().st_uid + 1)
    with own_folder("gapmes-x-", tmp_path):
        assert not (tmp_path / "made").exists()
    assert (left / "half").is_file()


def test_nothing_is_made_where_a_link_leads(tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    aged(elsewhere)
    (tmp_path / "gapmes-x-link").symlink_to(elsewhere)
    with own_folder("gapmes-x-", tmp_path):
        assert not list(elsewhere.iterdir())
