"""Data-parallel training: processes that divide the scenes of each step and average their gradients."""

from __future__ import annotations

import signal
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from multiprocessing import active_children
from pathlib import Path

import numba
import torch
import torch.distributed as distributed
import torch.multiprocessing as multiprocessing
from torch import nn
from torch.multiprocessing.spawn import ProcessException

from ..weights_file import CheckpointError
from .interrupts import without_interrupts
from .run_folder import Refused

LONGEST_WAIT = timedelta(hours=1)  # the first process validates and saves while the others wait
REFUSAL = "refusal"  # file with the message, beside the rendezvous file


@dataclass(frozen=True)
class Worker:
    """Process `rank` of `count`."""

    rank: int = 0
    count: int = 1

    @property
    def leads(self) -> bool:
        """Whether this process validates, logs and saves."""
        return self.rank == 0

    def average_gradients(self, parameters: list[nn.Parameter]) -> None:
        """Replace each gradient by its mean over the processes; a missing one counts as 0."""
        if self.count == 1:
            return
        grads = [torch.zeros_like(p) if p.grad is None else p.grad for p in parameters]
        flat = torch.cat([grad.flatten() for grad in grads]).cpu()
        distributed.all_reduce(flat)
        flat /= self.count
        for parameter, mean in zip(parameters, flat.split([p.numel() for p in parameters]), strict=True):
            parameter.grad = mean.view_as(parameter).to(parameter.device)


def run_workers(count: int, threads: int, work: Callable[..., None], *arguments: object) -> None:
    """Call `work(worker, *arguments)` in `count` processes of `threads` threads each; a failure in one of them, or an
    interrupt of this process, ends all.

    With one process `work` is called in this one. With several, `Refused` is raised for a refusal in one of them, even
    if another process that lost its connection fails first, and for a killed process; `ProcessException` for other
    failures.
    """
    if count == 1:
        limit_threads(threads)
        work(Worker(), *arguments)
        return
    with tempfile.TemporaryDirectory() as folder:
        refusal = Path(folder) / REFUSAL
        with _children_killed_at_end():
            with without_interrupts():  # until they have begun: while they import, one would end in a traceback
                processes = multiprocessing.spawn(_start, (count, threads, Path(folder), work, arguments), count, False)
            try:
                while not processes.join():
                    pass
            except ProcessException as error:
                if refusal.is_file():
                    raise Refused(refusal.read_text(encoding="utf-8")) from error
                if killed := [n for n, one in enumerate(processes.processes) if one.exitcode == -signal.SIGKILL]:
                    raise Refused(
                        f"process {killed[0]} of {count} was killed, for lack of memory perhaps; the same command goes "
                        "on from the last state"
                    ) from error
                raise


@contextmanager
def _children_killed_at_end() -> Iterator[None]:
    """Kill the processes started within the block when it ends, also by an interrupt."""
    before = {process.pid for process in active_children()}
    try:
        yield
    finally:
        for process in active_children():
            if process.pid not in before:
                process.kill()
                process.join()


def _start(
    rank: int, count: int, threads: int, folder: Path, work: Callable[..., None], arguments: tuple[object, ...]
) -> None:
    # torch sends SIGINT when the parent dies; a process that was started in the background would ignore it
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    limit_threads(threads)
    meeting_point = (folder / "rendezvous").as_uri()
    distributed.init_process_group("gloo", init_method=meeting_point, rank=rank, world_size=count, timeout=LONGEST_WAIT)
    try:
        work(Worker(rank, count), *arguments)
    except (Refused, CheckpointError, OSError) as error:  # written before the others lose the connection
        own = folder / f"{REFUSAL}-{rank}"
        own.write_text(str(error), encoding="utf-8")
        own.replace(folder / REFUSAL)  # whole at any time: several processes may refuse at once
        raise
    finally:
        distributed.destroy_process_group()


def limit_threads(threads: int) -> None:
    """Set the number of threads of torch and of numba in this process."""
    torch.set_num_threads(threads)
    numba.set_num_threads(threads)
