"""Ranges are each run once, on any number of threads, and an error in one reaches the caller."""

import threading

import pytest
from splat_cases import bits, camera, scene

from gapmes.service.errors import InputError
from gapmes.service.splat import render
from gapmes.service.splat.parallel import available_threads, checked_threads, run_ranges


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_results_come_in_order_without_the_empty_ranges(threads):
    bounds = [0, 0, 3, 3, 10, 11]
    assert run_ranges(lambda a, b: (a, b), bounds, threads) == [(0, 3), (3, 10), (10, 11)]


def test_an_error_reaches_the_caller():
    def work(a, b):
        if a == 3:
            raise ValueError("range 3")
        return a

    for threads in (1, 4):
        with pytest.raises(ValueError, match="range 3"):
            run_ranges(work, list(range(9)), threads)


def test_thread_counts():
    assert checked_threads(None) == available_threads() >= 1
    assert checked_threads(3) == 3
    with pytest.raises(InputError):
        checked_threads(0)


def test_concurrent_renders_do_not_disturb_each_other():
    gaussians, view = scene(800, 1), camera()
    expected, seen = bits(render(gaussians, view)), []
    workers = [threading.Thread(target=lambda: seen.append(bits(render(gaussians, view, threads=2)))) for _ in range(8)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert seen == [expected] * 8
