"""A process that works for another one does not outlive it."""

from __future__ import annotations

import subprocess
import sys
import time

from living import alive, wait_for

CHILD = """
import sys, time
from gapmes.service.process.with_parent import end_with_parent
end_with_parent(int(sys.argv[1]))
print("ready", flush=True)
time.sleep(600)
"""
PARENT = """
import os, subprocess, sys, time
child = subprocess.Popen([sys.executable, "-c", sys.argv[1], str(os.getpid())], stdout=subprocess.PIPE)
child.stdout.readline()
print(child.pid, flush=True)
time.sleep(600)
"""


def test_it_ends_when_its_parent_is_killed() -> None:
    with subprocess.Popen([sys.executable, "-c", PARENT, CHILD], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        try:
            time.sleep(2)
            assert alive(child)  # as long as the parent is
        finally:
            parent.kill()
    wait_for(lambda: not alive(child))


def test_it_ends_where_its_parent_has_ended_before() -> None:
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait(120)
    child = subprocess.run([sys.executable, "-c", CHILD, str(ended.pid)], stdout=subprocess.PIPE, timeout=120)
    assert child.returncode == 1
