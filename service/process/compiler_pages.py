"""The compiler's code, which a process that has its loops seldom needs: its pages leave the process's memory."""

from __future__ import annotations

import ctypes
import re
import sys
from collections.abc import Iterator
from pathlib import Path

from .allocator import gives_back

COMPILER = "libllvmlite"  # how the name of numba's begins
DONTNEED = 4  # of madvise(2)
_HEAD = re.compile(r"([0-9a-f]+)-([0-9a-f]+) (\S{4}) \S+ \S+ \S+ *(.*)")


def leave_compiler() -> int:
    """Drop the pages of the compiler's code, 52 MB or up to 84; returns how many bytes of it were resident.

    Where it is asked for something again they come back from its file. Nothing is done, and 0 returned, without
    `give_back_freed` and where the system does not tell what is in memory.
    """
    if not (gives_back() and sys.platform.startswith("linux")):
        return 0
    try:
        smaps = Path("/proc/self/smaps").read_text(encoding="utf-8", errors="surrogateescape")
    except OSError:
        return 0
    madvise = ctypes.CDLL(None).madvise
    madvise.argtypes = (ctypes.c_size_t, ctypes.c_size_t, ctypes.c_int)
    return sum(resident for start, size, resident in code_as_in_its_file(smaps) if not madvise(start, size, DONTNEED))


def code_as_in_its_file(smaps: str) -> Iterator[tuple[int, int, int]]:
    """(start, size, resident bytes) of each mapping of the compiler's code of which no page was ever written to: from
    another one what was written would be lost. `smaps` is as of proc_pid_smaps(5)."""
    head: re.Match[str] | None = None
    sizes: dict[str, int] = {}
    for line in (*smaps.split("\n"), "0-0 ---p 0 0 0"):  # the last ends the one before it
        if begins := _HEAD.fullmatch(line):
            if head and head[3].startswith("r-x") and Path(head[4]).name.startswith(COMPILER):
                start, end = int(head[1], 16), int(head[2], 16)
                if sizes.get("Anonymous", 1) == 0 and sizes.get("Swap", 0) == 0:
                    yield start, end - start, sizes.get("Rss", 0)
            head, sizes = begins, {}
        elif line.endswith(" kB"):
            name, kilobytes, _ = line.split()
            sizes[name.removesuffix(":")] = 1024 * int(kilobytes)
