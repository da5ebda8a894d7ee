"""Processes that share a port know when all of them are loaded, also those that join later."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from gapmes.service.process.peers import Peers, is_alive


@pytest.fixture
def gone() -> int:
    """The number of an ended process."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


@pytest.fixture
def living() -> Iterator[int]:
    """The number of another process of ours."""
    process = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    yield process.pid
    process.kill()
    process.wait()


@pytest.mark.parametrize("count", [1, 2])
def test_one_that_shares_no_folder_is_complete_by_itself(count: int) -> None:
    alone = Peers(count, None)
    alone.announce_loaded()
    assert alone.complete
    assert alone.may_listen_unloaded


def test_a_single_process_leaves_the_folder_of_others_alone(tmp_path: Path) -> None:
    alone = Peers(1, tmp_path)
    alone.announce_loaded()
    assert alone.complete
    assert list(tmp_path.iterdir()) == []


def test_what_was_announced_is_announced_again_where_the_folder_was_deleted(tmp_path: Path, living: int) -> None:
    """Who joins then would never learn that all are loaded."""
    folder = tmp_path / "shared"
    folder.mkdir()
    peers, unloaded = Peers(2, folder), Peers(2, folder)
    (folder / f"loaded_{living}").touch()
    peers.announce_loaded()
    assert peers.complete
    shutil.rmtree(folder)
    unloaded.keep()
    assert list(folder.iterdir()) == []
    peers.keep()
    assert sorted(path.name for path in folder.iterdir()) == ["complete", f"loaded_{os.getpid()}"]
    assert Peers(2, folder).complete
    assert Peers(2, folder).living() == [os.getpid()]


def test_they_are_complete_when_the_last_is_loaded_and_stay_so(tmp_path: Path, living: int) -> None:
    peers = Peers(2, tmp_path)
    peers.announce_loaded()
    peers.announce_loaded()  # the same one
    assert not peers.complete
    assert peers.may_listen_unloaded
    assert peers.living() == [os.getpid()]
    (tmp_path / f"loaded_{living}").touch()
    peers.announce_loaded()
    assert sorted(peers.living()) == sorted([os.getpid(), living])
    late = Peers(2, tmp_path)
    for each in (peers, late):
        assert each.complete
        assert not each.may_listen_unloaded
    for file in tmp_path.iterdir():  # whoever tidies there
        file.unlink()
    for each in (peers, late):
        assert each.complete
        assert each.may_listen_unloaded  # nobody else answers, as far as one can tell


def test_one_that_died_unseen_by_its_parent_does_not_live() -> None:
    process = subprocess.Popen([sys.executable, "-c", ""])
    os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
    assert not is_alive(process.pid)
    process.wait()


def test_one_that_died_does_not_count(tmp_path: Path, gone: int) -> None:
    assert not is_alive(gone)
    (tmp_path / f"loaded_{gone}").touch()
    peers = Peers(2, tmp_path)
    peers.announce_loaded()
    assert not peers.complete
    assert peers.living() == [os.getpid()]


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc, by which two processes of one id differ")
def test_a_later_process_with_the_id_of_one_that_was_loaded_does_not_count(tmp_path: Path, living: int) -> None:
    peers = Peers(2, tmp_path)
    peers.announce_loaded()
    (own,) = tmp_path.glob("loaded_*")
    (tmp_path / f"loaded_{living}").write_text(str(int(own.read_text()) - 1))
    assert peers.living() == [os.getpid()]
    assert not Peers(2, tmp_path).complete
