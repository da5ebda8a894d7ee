"""Scenes drawn ahead: processes of their own draw those of coming steps while the network computes."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Generator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import fields

import numba
import numpy as np
import torch
from numpy.typing import NDArray

from gapmes.service.with_parent import end_with_parent

from .recipe import Recipe
from .run_folder import Refused
from .step import TensorBatch
from .step_scenes import StepScenes, draw_step
from .workers import Worker

AHEAD = 2  # steps that each process may be ahead: one that it draws, one that waits

Drawn = tuple[list[NDArray[np.float32]], int, bool]  # by pipe: tensors would take shared memory, scarce in a container


def drawn_steps(recipe: Recipe, steps: range, worker: Worker, loaders: int) -> Generator[StepScenes]:
    """The scenes of `steps` in their order, drawn ahead by as many processes as `loaders`; without any, when asked for.

    The scenes are the same to the bit. Close the iterator to end the processes. Raises `Refused` when one was lost.
    """
    if not loaders:
        yield from (draw_step(recipe, step, worker) for step in steps)
        return
    spawn = multiprocessing.get_context("spawn")
    waiting: deque[Future[Drawn]] = deque()
    with ProcessPoolExecutor(loaders, mp_context=spawn, initializer=_begin, initargs=(os.getpid(),)) as pool:
        try:
            for step in steps:
                waiting.append(pool.submit(_draw, recipe, step, worker))
                if len(waiting) == AHEAD * loaders:
                    yield _received(waiting.popleft().result())
            while waiting:
                yield _received(waiting.popleft().result())
        except BrokenProcessPool as error:
            raise Refused(
                "a process that draws scenes ended, by lack of memory or by the error above; the same command goes on "
                "from the last state, with fewer --loaders in less memory"
            ) from error
        finally:
            pool.shutdown(cancel_futures=True)  # or it would draw what nobody takes


def _begin(parent: int) -> None:
    """In each process: one thread, and an interrupt is its parent's to hear."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent(parent)
    torch.set_num_threads(1)
    numba.set_num_threads(1)


def _draw(recipe: Recipe, step: int, worker: Worker) -> Drawn:
    drawn = draw_step(recipe, step, worker)
    arrays = [getattr(drawn.batch, field.name).numpy() for field in fields(TensorBatch)]
    return arrays, drawn.torch_seed, drawn.withheld


def _received(drawn: Drawn) -> StepScenes:
    arrays, torch_seed, withheld = drawn
    return StepScenes(TensorBatch(*map(torch.from_numpy, arrays)), torch_seed, withheld)
