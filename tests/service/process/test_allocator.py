"""The allocator's settings, in a separate process: freed memory returns to the system, or is used again."""

from __future__ import annotations

import mmap
import platform
import subprocess
import sys

import pytest

# Once a large block has been freed, glibc by itself takes smaller ones from its heap and keeps as much as twice that
# block's size of it.
SCRIPT = """
import resource, sys
from gapmes.service.process.allocator import give_back_freed

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


# Blocks of 4 MB, one after the other, within two contexts of which one ends later; page faults tell what was new.
REUSE = """
import resource, sys
from gapmes.service.process.allocator import freed_blocks_reused, give_back_freed

def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize()

def faults(rounds=50):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(rounds):
        block = b"x" * 4_000_000
        del block
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

if sys.argv[1] == "give back":
    assert give_back_freed()
start, exact = resident(), faults()
outer, inner = freed_blocks_reused(), freed_blocks_reused()
outer.__enter__()
inner.__enter__()
reused = faults()
outer.__exit__(None, None, None)
still = faults()
held = resident() - start
inner.__exit__(None, None, None)
print(exact, reused, still, held, resident() - start, faults())
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the settings are glibc's")
def test_freed_blocks_are_reused_within_and_go_back_after() -> None:
    """4 MB are some 980 pages of 4 KB: 50 blocks are 49,000 where each is new, 1,000 where one is taken again."""

    def run(mode: str) -> list[int]:
        found = subprocess.run([sys.executable, "-c", REUSE, mode], capture_output=True, text=True, check=True)
        return [int(value) for value in found.stdout.split()]

    exact, reused, still, held, after, again = run("give back")
    pages = 50 * 4e6 / mmap.PAGESIZE
    assert 0.4 * pages < min(exact, again)  # huge pages are fewer
    assert max(reused, still) < 0.1 * min(exact, again)
    assert held > 3.5e6
    assert after < 2e6  # measured below 0
    *_, last = run("as it is")
    assert last < 0.1 * min(exact, again)  # glibc's own way is left alone: it learns from the first block
