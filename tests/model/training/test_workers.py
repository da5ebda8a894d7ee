"""Two processes share a step: the averaged gradient and the weights are those of one process with all scenes."""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pytest
import torch
from child_processes import eventually, gone, in_a_terminal
from killed_runs import killed_with_a_state
from torch import nn
from torch.multiprocessing.spawn import ProcessException

from gapmes.model.checkpoint import load_checkpoint
from gapmes.model.config import preset
from gapmes.model.training import loop, run_folder, workers
from gapmes.model.training.recipe import Phase, Recipe
from gapmes.model.training.training_run import TrainingRun
from gapmes.model.training.workers import Worker, run_workers

SHARED = replace(
    Recipe(),
    steps=2,
    warm_up=1,
    zoom_share=0.0,
    input_noise=0.0,
    balance_weight=0.0,  # the balance of a process is that of its own scenes
    withheld_until=0.0,  # each process draws anew whether it has evidence
    phases=(Phase(1.0, (32,), 2, (2,), (0.1, 0.4)),),
)
CONFIG = preset("tiny", without_experts=True, without_tasks=True)  # no Gumbel noise, which each process draws anew


def _train(worker: Worker, folder: Path) -> None:
    loop.train(
        TrainingRun(CONFIG, SHARED, folder, validate_every=2, validation_scenes=1, save_seconds=1e9), worker=worker
    )


def _average(worker: Worker, folder: Path) -> None:
    values = [nn.Parameter(torch.zeros(2, 3)), nn.Parameter(torch.zeros(4))]
    values[0].grad = torch.full((2, 3), float(worker.rank + 1))
    if worker.rank == 1:
        values[1].grad = torch.arange(4.0)
    worker.average_gradients(values)
    text = json.dumps([value.grad.tolist() for value in values if value.grad is not None])
    (folder / f"{worker.rank}.json").write_text(text)


def _fail(worker: Worker) -> None:
    if worker.rank == 1:
        raise RuntimeError("this one fails")
    worker.average_gradients([nn.Parameter(torch.zeros(1))])  # waits for the other


def test_gradients_are_averaged_and_missing_ones_count_as_zero(tmp_path: Path) -> None:
    run_workers(2, 1, _average, tmp_path)
    first, second = (json.loads((tmp_path / f"{rank}.json").read_text()) for rank in (0, 1))
    assert first == second == [[[1.5] * 3] * 2, [0.0, 0.5, 1.0, 1.5]]


def test_two_processes_train_as_one_does(tmp_path: Path) -> None:
    run_workers(1, 1, _train, tmp_path / "one")
    run_workers(2, 1, _train, tmp_path / "two")
    one, two = (load_checkpoint(tmp_path / name / run_folder.WEIGHTS) for name in ("one", "two"))
    torch.manual_seed(SHARED.seed)
    start = loop.GaPMeS(CONFIG).requires_grad_(False)
    moved = torch.cat([(a - b).flatten() for a, b in zip(one.parameters(), start.parameters(), strict=True)])
    apart = torch.cat([(a - b).flatten() for a, b in zip(one.parameters(), two.parameters(), strict=True)])
    assert moved.detach().norm().item() > 0.1
    assert apart.detach().norm().item() < 0.1 * moved.detach().norm().item()


WHOLE = replace(
    SHARED, steps=4, zoom_share=0.5, input_noise=0.01, balance_weight=0.01, noise_until=0.75, withheld_until=0.75
)


def _train_all_of_it(worker: Worker, folder: Path, loaders: int) -> None:
    loop.train(
        TrainingRun(
            preset("tiny"),
            WHOLE,
            folder,
            validate_every=4,
            validation_scenes=1,
            save_seconds=0.0,
            loaders=loaders,
        ),
        worker=worker,
    )


def _train_in_two(folder: Path) -> None:
    run_workers(2, 1, _train_all_of_it, folder, 0)


def _train_in_two_with_scenes_ahead(folder: Path) -> None:
    run_workers(2, 1, _train_all_of_it, folder, 1)


def test_two_processes_of_the_whole_method_resume_after_a_kill(tmp_path: Path) -> None:
    """The whole recipe with all that it draws, at four steps; the process that started both is killed, while others
    draw scenes ahead for both, and they go on without these."""
    _train_in_two(tmp_path / "whole")
    killed_with_a_state(_train_in_two_with_scenes_ahead, tmp_path / "killed", daemon=False)
    until = time.monotonic() + 60
    while True:  # its children end by themselves
        try:
            with run_folder.claimed(tmp_path / "killed"):
                break
        except ValueError:
            assert time.monotonic() < until
            time.sleep(0.05)
    assert torch.load(tmp_path / "killed" / run_folder.STATE, weights_only=True)["step"] < WHOLE.steps
    _train_in_two(tmp_path / "killed")
    whole, killed = (load_checkpoint(tmp_path / name / run_folder.WEIGHTS) for name in ("whole", "killed"))
    assert all(torch.equal(a, b) for a, b in zip(whole.parameters(), killed.parameters(), strict=True))


def _refuse(worker: Worker) -> None:
    raise run_folder.Refused("this is refused")


def test_a_refusal_in_a_process_is_a_refusal() -> None:
    with pytest.raises(run_folder.Refused, match=r"^this is refused$"):
        run_workers(2, 1, _refuse)


def test_what_the_system_refuses_in_a_process_is_told_as_a_refusal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The process itself, without another that waits for it."""

    def full(worker: Worker) -> None:
        raise OSError(28, "No space left on device", "state.pt.part")

    monkeypatch.setattr(workers, "signal", Mock())
    monkeypatch.setattr(workers, "distributed", Mock())
    with pytest.raises(OSError, match="No space left"):
        workers._start(0, 2, 1, tmp_path, full, ())
    assert "No space left on device: 'state.pt.part'" in (tmp_path / workers.REFUSAL).read_text()


def test_refusals_at_once_are_never_read_by_half(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """While a second process writes its refusal, that of the first is there."""
    monkeypatch.setattr(workers, "signal", Mock())
    monkeypatch.setattr(workers, "distributed", Mock())
    with pytest.raises(run_folder.Refused):
        workers._start(0, 2, 1, tmp_path, _refuse, ())
    real, seen = Path.write_text, []

    def written(path: Path, text: str, **options: str) -> int:
        with path.open("w"):  # as between opening and writing
            seen.append((tmp_path / workers.REFUSAL).read_text())
        return real(path, text, **options)

    monkeypatch.setattr(Path, "write_text", written)
    with pytest.raises(run_folder.Refused):
        workers._start(1, 2, 1, tmp_path, _refuse, ())
    assert seen == ["this is refused"]


WORKS_ON = """
import os, sys, time
from pathlib import Path
from gapmes.model.training.workers import run_workers


def work_on(worker, folder):
    (folder / f"{worker.rank}.pid").write_text(str(os.getpid()))
    time.sleep(600)


if __name__ == "__main__":
    run_workers(2, 1, work_on, Path(sys.argv[1]))
"""


def test_an_interrupt_of_the_first_process_alone_ends_all(tmp_path: Path) -> None:
    """In a process of its own: an interrupt that came late would end that of the tests."""
    script = tmp_path / "works_on.py"
    script.write_text(WORKS_ON)
    with in_a_terminal([sys.executable, str(script), str(tmp_path)], tmp_path) as run:
        eventually(lambda: len(pids := list(tmp_path.glob("*.pid"))) == 2 and all(pid.read_text() for pid in pids))
        os.kill(run.pid, signal.SIGINT)
        _, told = run.communicate(timeout=120)
    assert run.returncode == -signal.SIGINT
    assert "KeyboardInterrupt" in told
    for pid in tmp_path.glob("*.pid"):
        eventually(lambda pid=pid: gone(int(pid.read_text())))


def _refuse_and_stay(worker: Worker) -> None:
    if worker.leads:
        threading.Timer(3.0, int).start()  # the process ends after it: the other's failure is heard before
        raise run_folder.Refused("only one refuses")
    torch.distributed.all_reduce(torch.zeros(1))


def test_a_refusal_is_heard_where_another_process_fails_for_it() -> None:
    with pytest.raises(run_folder.Refused, match=r"^only one refuses$"):
        run_workers(2, 1, _refuse_and_stay)


def _killed(worker: Worker) -> None:
    if not worker.leads:
        os.kill(os.getpid(), signal.SIGKILL)
    torch.distributed.all_reduce(torch.zeros(1))


def test_a_process_that_was_killed_is_told_as_one() -> None:
    with pytest.raises(run_folder.Refused, match=r"^process 1 of 2 was killed, .* goes on from the last state$"):
        run_workers(2, 1, _killed)


def test_a_failure_ends_all(tmp_path: Path) -> None:
    # the other one, left waiting, may be the first to be heard
    with pytest.raises(ProcessException, match=r"this one fails|Connection closed by peer|Connection reset by peer"):
        run_workers(2, 1, _fail)


def test_scenes_that_cannot_be_shared_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"processes: 3 cannot share the 2 scenes of a step at 32 px"):
        loop.train(TrainingRun(CONFIG, SHARED, tmp_path), worker=Worker(0, 3))
