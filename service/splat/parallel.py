"""Kernels over index ranges on several threads; results do not depend on their number.

Kernels release the GIL, so plain threads suffice. Numba's parallel backends abort the process when two requests render
at once or after a fork, and their idle threads busy-wait beside onnxruntime's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache
from itertools import pairwise
from typing import TypeVar

from ..arguments import shown, whole_number
from ..errors import InputError
from ..process.threads import available_threads

T = TypeVar("T")


def checked_threads(threads: int | None) -> int:
    """The number of threads; None is all available ones. Raises `InputError` unless it is a whole number from 1 on."""
    if threads is None:
        return available_threads()
    count = whole_number(threads)
    if count is None or count < 1:
        raise InputError(f"is {shown(threads)}, need a whole number of at least 1", field="threads")
    return count


def run_ranges(work: Callable[[int, int], T], bounds: Iterable[int], threads: int) -> list[T]:
    """[work(bounds[0], bounds[1]), work(bounds[1], bounds[2]), ...] without empty ranges.

    The calling thread works too and never waits for a helper that has not started, so a busy or forked pool costs only
    time. An error in one range is raised after all helpers have stopped. `work` must write only to memory that belongs
    to its range.
    """
    ranges = [(int(a), int(b)) for a, b in pairwise(bounds) if a < b]
    results: dict[int, T] = {}
    if threads == 1 or len(ranges) < 2:
        return [work(start, stop) for start, stop in ranges]
    todo, works = iter(range(len(ranges))), [work]

    def drain(todo: Iterator[int]) -> None:
        for item in todo:
            results[item] = works[0](*ranges[item])

    helpers = [_pool().submit(drain, todo) for _ in range(min(threads, len(ranges)) - 1)]
    try:
        drain(todo)
    finally:
        started = [helper for helper in helpers if not helper.cancel()]
        wait(started)
        works.clear()  # those that were cancelled lie in the pool's queue for a while, and would keep its arrays
        found = dict(results)
        results.clear()
    for helper in started:
        helper.result()
    return [found[item] for item in range(len(ranges))]


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max_workers=max(16, available_threads()), thread_name_prefix="gapmes-splat")
