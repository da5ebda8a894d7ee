"""Signals that end a command: partial files are removed, and ignored signals stay ignored."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from gapmes.service.process.ending import SIGNALS, ended_in_order

# Leaves a whole file and parts of others, says that it is ready, and waits.
HALF = """
import time
from pathlib import Path
from gapmes.service.process.ending import ended_in_order, unfinished
whole, part, folder = (Path(name) for name in ("whole", "part", "folder"))
with ended_in_order():
    for path in (whole, part):
        path.write_text("1")
    folder.mkdir()
    (folder / "part").write_text("1")
    with unfinished(whole):
        pass
    with unfinished(part), unfinished(folder), unfinished(Path("never made")):
        print("ready", flush=True)
        for _ in range(12_000):
            time.sleep(0.05)  # a signal that comes just before a wait is heard behind it
"""


@pytest.fixture(autouse=True)
def as_by_default() -> Iterator[None]:
    before = {number: signal.signal(number, signal.SIG_DFL) for number in SIGNALS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_takes_what_is_unfinished_and_ends_the_process(tmp_path: Path, number: signal.Signals) -> None:
    process = subprocess.Popen([sys.executable, "-c", HALF], cwd=tmp_path, stdout=subprocess.PIPE, text=True)
    with process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.send_signal(number)
        assert process.wait(120) == -number
    assert [path.name for path in tmp_path.iterdir()] == ["whole"]


def test_all_is_as_before_when_the_block_is_left() -> None:
    with ended_in_order():
        assert signal.SIG_DFL not in [signal.getsignal(number) for number in SIGNALS]
    assert [signal.getsignal(number) for number in SIGNALS] == [signal.SIG_DFL] * 2


def test_what_is_ignored_or_heard_elsewhere_stays_so() -> None:
    """As under nohup, and in a program that calls the command and has a handler of its own."""
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with ended_in_order():
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
        assert signal.getsignal(signal.SIGTERM) == signal.default_int_handler
    assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN


def test_another_thread_may_run_a_command() -> None:
    found: list[object] = []

    def work() -> None:
        with ended_in_order():
            found.extend(signal.getsignal(number) for number in SIGNALS)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join(120)
    assert found == [signal.SIG_DFL] * 2
