"""The allocator's settings, in a process of their own: what was freed goes back to the system."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

# Once a large block has been freed, glibc by itself takes smaller ones from its heap and keeps as much as twice that
# block's size of it.
SCRIPT = """
import resource, sys
from gapmes.service.allocator import give_back_freed

def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize()

if sys.argv[1] == "give back":
    assert give_back_freed()
before = resident()
large, small = 24_000_000, 4_000_000
block = b"x" * large
del block
blocks = [b"x" * small for _ in range(8)]
most = resident()
blocks.clear()
print(most - before, resident() - before)
"""


def resident(mode: str) -> tuple[int, int]:
    """Bytes beyond the start: with 32 MB in use, and when they are freed."""
    found = subprocess.run([sys.executable, "-c", SCRIPT, mode], capture_output=True, text=True, check=True)
    most, after = map(int, found.stdout.split())
    return most, after


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the settings are glibc's")
def test_what_was_freed_goes_back() -> None:
    most, after = resident("give back")
    assert most > 30e6
    assert after < 4e6  # measured 0
    assert resident("as it is")[1] > 16e6  # measured 32 MB
