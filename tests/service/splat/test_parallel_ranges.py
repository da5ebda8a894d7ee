"""Every range runs once, on any number of threads, and an error in one reaches the caller."""

import threading
import time
import weakref
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from splat_cases import bits, camera, scene

from gapmes.service.errors import InputError
from gapmes.service.splat import parallel, render
from gapmes.service.splat.options import OUTPUTS
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
    """One set of Gaussians, but every thread has a camera and a subset of its own."""
    gaussians = scene(800, 1)
    views = [camera(48 + 8 * number, 40, 30.0 + 10 * number) for number in range(8)]
    subsets = [np.random.default_rng(number).random(800) < 0.5 for number in range(8)]

    def draw(number):
        image = render(gaussians, views[number], threads=2, outputs=OUTPUTS, subset=subsets[number])
        return bits(image) + image.removed.tobytes() + image.peaks.tobytes()

    expected = [draw(number) for number in range(8)]
    with ThreadPoolExecutor(8) as pool:
        for _ in range(5):
            assert list(pool.map(draw, range(8))) == expected


def test_no_helper_works_any_more_when_an_error_arrives():
    begun, ended = [], []

    def work(a, b):
        begun.append(a)
        if a == 0:
            time.sleep(0.02)
            raise ValueError("range 0")
        time.sleep(0.1)
        ended.append(a)

    with pytest.raises(ValueError, match="range 0"):
        run_ranges(work, list(range(7)), 4)
    assert sorted(begun) == sorted([0, *ended])


def test_what_a_helper_that_never_started_would_have_worked_on_is_let_go():
    """The pool is busy, so that the caller does all of the work, and the helper's task lies in the queue."""
    go, pool = threading.Event(), parallel._pool()
    busy = [pool.submit(go.wait) for _ in range(pool._max_workers)]
    try:
        plane = np.zeros(3)
        gone = weakref.ref(plane)

        def work(a, b, plane=plane):
            plane[a] += 1

        run_ranges(work, range(4), 2)
        assert (plane == 1).all()
        del plane, work
        assert gone() is None
    finally:
        go.set()
        for task in busy:
            task.result()
