"""Prefetching of scenes: separate processes draw those of coming steps while the network computes."""

from __future__ import annotations

import os
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import fields
from multiprocessing import get_context
from multiprocessing.connection import Connection

import torch
from numpy.typing import NDArray

from gapmes.service.process.with_parent import end_with_parent

from .interrupts import without_interrupts
from .recipe import Recipe
from .run_folder import Refused
from .step import TensorBatch
from .step_scenes import StepScenes, draw_step
from .workers import Worker, limit_threads

Drawn = tuple[list[NDArray], int, bool]  # arrays: tensors would be sent through scarce shared memory


def drawn_steps(recipe: Recipe, steps: range, worker: Worker, loaders: int) -> Generator[StepScenes]:
    """The scenes of `steps` in order, prefetched by `loaders` processes, or drawn on demand with 0.

    The result does not depend on `loaders`. Each process is ahead by one step. Close the generator to end the
    processes. Raises `Refused` when one of them has ended for any reason.
    """
    if not loaders:
        yield from (draw_step(recipe, step, worker) for step in steps)
        return
    with _started(recipe, steps, worker, loaders) as pipes:
        for position in range(len(steps)):
            yield _received(pipes[position % loaders])


@contextmanager
def _started(recipe: Recipe, steps: range, worker: Worker, loaders: int) -> Iterator[list[Connection]]:
    """One pipe for each process; process i draws every step of number i, i + loaders, ... in `steps`."""
    spawn = get_context("spawn")
    processes, pipes = [], []
    try:
        for number in range(min(loaders, len(steps))):
            receiver, sender = spawn.Pipe(duplex=False)
            pipes.append(receiver)
            with sender, without_interrupts():  # the process holds the only sender: the pipe ends with it
                own = (recipe, steps[number::loaders], worker, sender, os.getpid())
                process = spawn.Process(target=_draw, args=own, daemon=True)
                process.start()
                processes.append(process)
        yield pipes
    finally:
        for process in processes:
            process.kill()
        for process in processes:
            process.join()
        for pipe in pipes:
            pipe.close()


def _draw(recipe: Recipe, steps: range, worker: Worker, sender: Connection, parent: int) -> None:
    """Generate and send the batches of `steps`, in a process of its own with one thread."""
    end_with_parent(parent)
    limit_threads(1)
    for step in steps:
        drawn = draw_step(recipe, step, worker)
        arrays = [getattr(drawn.batch, field.name).numpy() for field in fields(TensorBatch)]
        try:
            sender.send((arrays, drawn.torch_seed, drawn.withheld))
        except BrokenPipeError:  # the training has ended
            return


def _received(pipe: Connection) -> StepScenes:
    try:
        drawn: Drawn = pipe.recv()
    except (EOFError, OSError) as error:  # it ended between two messages, or within one
        raise Refused(
            "a process that draws scenes ended, by lack of memory or by the error above; the same command goes on from "
            "the last state, with fewer --loaders in less memory"
        ) from error
    arrays, torch_seed, withheld = drawn
    return StepScenes(TensorBatch(*map(torch.from_numpy, arrays)), torch_seed, withheld)
