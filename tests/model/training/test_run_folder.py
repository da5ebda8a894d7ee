"""The folder of a run: which run is continued, and which is refused."""

from __future__ import annotations

import resource
import signal
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pytest
import torch
from test_training_loop import SMALL, one_thread, run

from gapmes.model.config import preset
from gapmes.model.network import GaPMeS
from gapmes.model.training import loop, run_folder
from gapmes.model.training.recipe import Phase
from gapmes.model.training.training_run import TrainingRun
from gapmes.model.training.workers import Worker


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    one_thread()


def test_two_runs_do_not_share_a_folder(tmp_path: Path) -> None:
    with run_folder.claimed(tmp_path), pytest.raises(ValueError, match="another run is at work there"):
        run(SMALL, tmp_path)


def test_a_run_of_another_recipe_is_not_continued(tmp_path: Path) -> None:
    run(replace(SMALL, steps=1), tmp_path)
    with pytest.raises(run_folder.Refused, match=r"another recipe: steps is 1, asked for 4; go on with what it began"):
        run(SMALL, tmp_path)


def test_a_run_of_another_number_of_processes_is_not_continued(tmp_path: Path) -> None:
    """Each process draws its own noise, so two give other weights than one."""
    two = replace(SMALL, steps=1, phases=(Phase(1.0, (32,), 2, (2,), (0.1, 0.4)),))
    run(two, tmp_path)
    with pytest.raises(run_folder.Refused, match="another process count: 1, asked for 2; go on with what"):
        loop.train(TrainingRun(preset("tiny"), two, tmp_path), worker=Worker(0, 2))


def test_a_run_of_another_number_of_threads_is_not_continued(tmp_path: Path) -> None:
    """Two threads add in another order than one, and round differently."""
    one = replace(SMALL, steps=1)
    run(one, tmp_path)
    torch.set_num_threads(2)
    with pytest.raises(run_folder.Refused, match="another thread count: 1, asked for 2; go on with what it began with"):
        run(one, tmp_path)


@pytest.mark.parametrize(
    ("key", "cure"),
    [
        ("precision", "the device decides it, so go on on one like that of the beginning, or use a new folder"),
        ("revision", "go on with the version of gapmes that it began with, or use a new folder"),
    ],
)
def test_what_no_option_sets_has_another_cure(key: str, cure: str, tmp_path: Path) -> None:
    torch.save({"step": 1, key: "another"}, tmp_path / run_folder.STATE)
    with pytest.raises(run_folder.Refused, match=f"another {key}: another, asked for this; {cure}"):
        run_folder.restore_state(tmp_path, {key: "this"}, *[Mock()] * 3)


def test_a_lack_of_memory_is_no_damage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A new folder would throw a good state away."""
    monkeypatch.setattr(torch, "load", lambda *_, **__: torch.empty(2**58))
    with pytest.raises(run_folder.Refused, match=r"not enough memory to read .*state\.pt .*; free some") as told:
        run_folder.read_state(tmp_path / run_folder.STATE)
    assert "damaged" not in str(told.value)


@pytest.mark.parametrize("room", [0, 10, 100_000])
def test_a_full_disk_is_said_of_the_file(room: int, tmp_path: Path) -> None:
    """torch's own message would be that a position is unexpected."""
    run(SMALL, tmp_path)
    before = (tmp_path / run_folder.STATE).read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    again = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    network = GaPMeS(preset("tiny"))
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, limits[1]))
        with pytest.raises(OSError, match=r"File too large: '.*state\.pt\.part'"):
            run_folder.save_state(tmp_path, {"step": 1}, network, network, torch.optim.SGD(network.parameters(), 0.1))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, again)
    assert (tmp_path / run_folder.STATE).read_bytes() == before
    assert not (tmp_path / (run_folder.STATE + ".part")).exists()


def test_a_state_is_on_the_disk_before_it_replaces_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A power failure may undo neither, or the rename alone."""
    done: list[str] = []
    replace_, fsync = run_folder.os.replace, run_folder.os.fsync

    def synced(handle: int) -> None:
        done.append(f"sync {Path(f'/proc/self/fd/{handle}').readlink().name}")
        fsync(handle)

    def replaced(source: Path, target: Path) -> None:
        done.append(f"rename {Path(source).name}")
        replace_(source, target)

    monkeypatch.setattr(run_folder.os, "fsync", synced)
    monkeypatch.setattr(run_folder.os, "replace", replaced)
    network = GaPMeS(preset("tiny"))
    run_folder.save_state(tmp_path, {"step": 1}, network, network, torch.optim.SGD(network.parameters(), 0.1))
    assert done[:2] == ["sync state.pt.part", "rename state.pt.part"]


def test_weights_without_a_state_are_not_written_over(tmp_path: Path) -> None:
    """Their state was removed after the run, or they come from elsewhere."""
    one = replace(SMALL, steps=1)
    run(one, tmp_path)
    (tmp_path / run_folder.STATE).unlink()
    kept = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert kept[run_folder.LOG]
    with pytest.raises(run_folder.Refused, match=r"holds weights\.safetensors but no state\.pt to go on from: .*move"):
        run(one, tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == kept


def test_a_state_with_other_numbers_than_were_written_is_not_continued(tmp_path: Path) -> None:
    """One byte differs in the middle, within a tensor, where the reader of torch compares no checksum."""
    one = replace(SMALL, steps=1)
    run(one, tmp_path)
    content = bytearray((tmp_path / run_folder.STATE).read_bytes())
    content[len(content) // 2] ^= 0x40
    (tmp_path / run_folder.STATE).write_bytes(content)
    torch.load(tmp_path / run_folder.STATE, weights_only=True)
    with pytest.raises(run_folder.Refused, match=r"state\.pt cannot be read .*\(ValueError: .* has another checksum"):
        run(one, tmp_path)


def test_a_state_that_lacks_a_part_is_not_continued(tmp_path: Path) -> None:
    one = replace(SMALL, steps=1)
    run(one, tmp_path)
    state = torch.load(tmp_path / run_folder.STATE, weights_only=True)
    torch.save({key: value for key, value in state.items() if key != "optimiser"}, tmp_path / run_folder.STATE)
    with pytest.raises(run_folder.Refused, match=r"state\.pt cannot be read as the state of a run \(KeyError: 'optimi"):
        run(one, tmp_path)
