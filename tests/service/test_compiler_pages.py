"""The compiler's pages leave a process that gives memory back, come back when they are needed, and are left alone where
they are not as in their file."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from gapmes.service import compiler_pages
from gapmes.service.compiler_pages import code_as_in_its_file
from gapmes.service.kernels import warm_up

PROGRAM = """
import json
from pathlib import Path
import numba
from gapmes.service.allocator import give_back_freed
from gapmes.service.compiler_pages import code_as_in_its_file, leave_compiler

def resident():
    return sum(part[2] for part in code_as_in_its_file(Path("/proc/self/smaps").read_text()))

give_back_freed()
numba.njit(lambda x: x + 1)(1)
before = resident()
left = leave_compiler()
after = resident()
again = numba.njit(lambda x: 3 * x)(14)  # compiles
print(json.dumps([before, left, after, again, resident()]))
"""
MAPPING = """7f0000000000-7f0000400000 {rights} 00300000 fe:00 123                        {path}
Size:               4096 kB
Rss:                2048 kB
Private_Dirty:         0 kB
Anonymous:           {anonymous} kB
THPeligible:           0
VmFlags: rd ex mr mw me
"""
PATH = "/a folder/llvmlite/binding/libllvmlite.so"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads Linux's /proc")
def test_pages_go_and_come_back() -> None:
    warm_up()
    found = subprocess.run([sys.executable, "-c", PROGRAM], check=True, capture_output=True, text=True, timeout=300)
    before, left, after, again, at_last = json.loads(found.stdout)
    assert left == before > 20e6  # LLVM has 84 MB of code
    assert after < 0.2 * before
    assert again == 42
    assert at_last > after


def test_a_process_that_keeps_its_memory_keeps_these(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiler_pages, "gives_back", lambda: False)
    assert compiler_pages.leave_compiler() == 0


@pytest.mark.parametrize(
    ("rights", "path", "anonymous", "taken"),
    [
        ("r-xp", PATH, 0, True),
        ("r-xp", PATH.replace(".so", "-0a1b2c.so.20"), 0, True),
        ("r-xp", PATH, 4, False),  # written to, as by a debugger
        ("r--p", PATH, 0, False),
        ("rw-p", PATH, 0, False),
        ("r-xp", "/usr/lib/libllvmlite/libc.so.6", 0, False),
        ("r-xp", "", 0, False),
    ],
)
def test_only_code_as_it_is_in_its_file_is_taken(rights: str, path: str, anonymous: int, taken: bool) -> None:
    other = MAPPING.format(rights="r-xp", path="/usr/lib/libc.so.6", anonymous=0)
    smaps = other + MAPPING.format(rights=rights, path=path, anonymous=anonymous) + other
    expected = [(0x7F0000000000, 4 << 20, 2 << 20)] if taken else []
    assert list(code_as_in_its_file(smaps)) == expected
    assert list(code_as_in_its_file(smaps.removesuffix(other))) == expected
