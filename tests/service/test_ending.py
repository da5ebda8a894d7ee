"""The signals that end a command: unwound once, at once the second time, and left to who has decided otherwise."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator

import pytest

from gapmes.service.ending import SIGNALS, unwound


@pytest.fixture(autouse=True)
def as_by_default() -> Iterator[None]:
    before = {number: signal.signal(number, signal.SIG_DFL) for number in SIGNALS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", SIGNALS)
def test_the_first_signal_unwinds_and_the_second_ends_at_once(number: signal.Signals) -> None:
    meanwhile: list[object] = []

    def work() -> None:
        try:
            os.kill(os.getpid(), number)  # is heard before the next line
            meanwhile.append("went on")
        finally:
            meanwhile.extend(signal.getsignal(each) for each in SIGNALS)

    with pytest.raises(SystemExit) as ended, unwound():
        work()
    assert ended.value.code == 128 + number
    assert meanwhile == [signal.SIG_DFL] * 2


def test_all_is_as_before_when_the_block_is_left() -> None:
    with unwound():
        assert signal.SIG_DFL not in [signal.getsignal(number) for number in SIGNALS]
    assert [signal.getsignal(number) for number in SIGNALS] == [signal.SIG_DFL] * 2


def test_what_is_ignored_or_heard_elsewhere_stays_so() -> None:
    """As under nohup, and in a program that calls the command and has a handler of its own."""
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with unwound():
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
        assert signal.getsignal(signal.SIGTERM) == signal.default_int_handler
    assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN


def test_another_thread_may_run_a_command() -> None:
    found: list[object] = []

    def work() -> None:
        with unwound():
            found.extend(signal.getsignal(number) for number in SIGNALS)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join(120)
    assert found == [signal.SIG_DFL] * 2
