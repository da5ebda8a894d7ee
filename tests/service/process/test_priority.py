"""Threads that give way have a lower priority than the main thread, however low that is."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
import os, sys, threading
from gapmes.service.process.priority import give_way

def own():
    return os.getpriority(os.PRIO_PROCESS, threading.get_native_id())

def give():
    give_way()
    give_way()
    found.append(own())
    inheriting = threading.Thread(target=lambda: found.append(own()))
    inheriting.start()
    inheriting.join()

found, main = [], os.nice(max(0, int(sys.argv[1]) - os.nice(0)))
giving = threading.Thread(target=give)
giving.start()
giving.join()
sys.stdout.write(f"{main} {own()} {found[0]} {found[1]}")
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has priorities per thread")
@pytest.mark.parametrize("nice", [0, 8, 18])
def test_a_thread_gives_way_to_the_main_one_and_so_do_those_that_it_starts(nice: int, tmp_path: Path) -> None:
    """By five steps, of which the system has 19 at most."""
    command = [sys.executable, "-c", SCRIPT, str(nice)]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    before, main, giving, inheriting = map(int, run.stdout.split())
    assert main == before >= nice
    assert giving == inheriting == min(main + 5, 19)
