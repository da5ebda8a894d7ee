"""The pool of models: loaded once, always within the budget, never dropped in use, in order of requests."""

from __future__ import annotations

import gc
import threading
import time
import weakref
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gapmes.service.model_pool import Pool

SIZES = {"a": 3, "b": 4, "c": 5, "d": 1}


class Thing:
    """What the tests load."""

    def __init__(self, name: str) -> None:
        self.name = name


class Loader:
    """Counts, and knows at every moment what is alive."""

    def __init__(self, seconds: float = 0.0) -> None:
        self.calls: list[str] = []
        self.alive: weakref.WeakSet[Thing] = weakref.WeakSet()
        self.failing: set[str] = set()
        self._seconds = seconds
        self._lock = threading.Lock()

    def __call__(self, name: str) -> Thing:
        with self._lock:
            self.calls.append(name)
        time.sleep(self._seconds)
        if name in self.failing:
            raise OSError(f"{name} is damaged")
        thing = Thing(name)
        self.alive.add(thing)
        return thing


def until(reached: Callable[[], bool], seconds: float = 120.0) -> None:
    deadline = time.monotonic() + seconds
    while not reached():
        assert time.monotonic() < deadline
        time.sleep(0.002)


@settings(max_examples=200)
@given(
    st.integers(5, 14),
    st.lists(st.sampled_from(sorted(SIZES)), max_size=40),
)
def test_it_is_what_a_list_in_order_of_use_would_be(budget: int, asked: list[str]) -> None:
    """One user at a time: what is loaded are the names used last, as many as fit."""
    loader = Loader()
    pool = Pool(loader, SIZES, budget)
    recent: list[str] = []  # what must be loaded, the last used at the end
    for name in asked:
        with pool.using(name) as thing:
            assert thing.name == name
            if name in recent:
                recent.remove(name)
            else:
                while sum(SIZES[other] for other in recent) + SIZES[name] > budget:
                    recent.pop(0)
            recent.append(name)
        assert {other for other in SIZES if pool.loaded(other)} == set(recent)
        assert pool.used_bytes() == sum(SIZES[other] for other in recent) <= budget
        del thing
    assert {thing.name for thing in loader.alive} == set(recent)  # what was dropped is gone from memory


@settings(max_examples=60)
@given(
    st.integers(5, 14), st.lists(st.sampled_from(sorted(SIZES)), min_size=1, max_size=6), st.sampled_from(sorted(SIZES))
)
def test_nothing_goes_while_it_is_used(budget: int, held: list[str], wanted: str) -> None:
    pool = Pool(loader := Loader(), SIZES, budget)
    with ExitStack() as stack:
        taken: set[str] = set()
        for name in held:
            if name in taken or sum(SIZES[other] for other in taken | {name}) <= budget:
                thing = stack.enter_context(pool.using(name))
                taken.add(name)
                assert thing.name == name
        fits = wanted in taken or sum(SIZES[other] for other in taken | {wanted}) <= budget
        waiter = threading.Thread(target=lambda: pool.using(wanted).__enter__(), daemon=True)
        waiter.start()
        waiter.join(120.0 if fits else 0.02)
        assert waiter.is_alive() is not fits
        assert all(pool.loaded(name) for name in taken)
        assert loader.calls.count(held[0]) == 1 or held[0] not in taken
    waiter.join(120.0)  # there is room once the others have left
    assert not waiter.is_alive()
    assert pool.loaded(wanted)


def test_asked_for_at_once_it_is_loaded_once() -> None:
    pool = Pool(loader := Loader(seconds=0.05), SIZES)
    barrier, found = threading.Barrier(8), set()

    def ask(_: int) -> None:
        barrier.wait()
        with pool.using("a") as thing:
            found.add(id(thing))

    with ThreadPoolExecutor(8) as threads:
        list(threads.map(ask, range(8)))
    assert loader.calls == ["a"]
    assert len(found) == 1


def test_two_different_ones_are_loaded_side_by_side() -> None:
    inside = threading.Barrier(2)

    def load(name: str) -> str:
        inside.wait(120)  # broken if the second waited for the first
        return name

    pool = Pool(load, SIZES)

    def ask(name: str) -> str:
        with pool.using(name) as thing:
            return thing

    with ThreadPoolExecutor(2) as threads:
        assert list(threads.map(ask, "ab")) == ["a", "b"]


def test_many_threads_never_exceed_the_budget_and_all_are_served() -> None:
    loader, budget = Loader(seconds=0.0005), 8
    pool = Pool(loader, SIZES, budget)
    over: list[int] = []

    def ask(number: int) -> None:
        name = sorted(SIZES)[number * 7 % 4]
        with pool.using(name) as thing:
            assert thing.name == name
            if (used := pool.used_bytes()) > budget:
                over.append(used)
            time.sleep(0.0005)

    with ThreadPoolExecutor(12) as threads:
        list(threads.map(ask, range(400)))
    assert not over
    gc.collect()
    assert sum(SIZES[thing.name] for thing in loader.alive) <= budget


def test_who_waits_for_room_is_not_kept_out_by_those_who_come_later() -> None:
    pool = Pool(Loader(), {"busy": 2, "rare": 2}, 2)
    order: list[str] = []

    def ask(name: str) -> None:
        with pool.using(name):
            order.append(name)

    with pool.using("busy"):
        waiting = []
        for name in ("rare", "busy", "busy"):
            waiting.append(threading.Thread(target=ask, args=[name]))
            waiting[-1].start()
            until(lambda: len(pool._queue) == len(waiting))
        assert order == []
    for thread in waiting:
        thread.join(120)
    assert order == ["rare", "busy", "busy"]


def test_what_cannot_be_loaded_is_told_to_all_and_tried_anew() -> None:
    pool = Pool(loader := Loader(seconds=0.05), SIZES, 5)
    loader.failing = {"a"}
    barrier = threading.Barrier(3)

    def ask(_: int) -> str:
        barrier.wait()
        try:
            with pool.using("a"):
                return "there"
        except OSError as error:
            return str(error)

    with ThreadPoolExecutor(3) as threads:
        assert set(threads.map(ask, range(3))) == {"a is damaged"}
    assert not pool.loaded("a")
    assert pool.used_bytes() == 0
    with pool.using("c"):  # its room is free again
        pass
    loader.failing = set()
    with pool.using("a") as thing:
        assert thing.name == "a"


def test_an_error_in_the_block_leaves_the_thing_idle() -> None:
    pool = Pool(Loader(), SIZES, 5)
    with pytest.raises(ZeroDivisionError), pool.using("c"):
        raise ZeroDivisionError
    with pool.using("b"):
        assert not pool.loaded("c")


def test_what_alone_is_over_the_budget_is_refused_at_once() -> None:
    with pytest.raises(ValueError, match="c alone is larger"):
        Pool(Loader(), SIZES, 4)
