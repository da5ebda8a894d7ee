"""The compiler's pages leave a process that releases memory, return when needed, and stay where they differ from their
file."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from plane_scene import PlaneScene

from gapmes.service import reconstruct
from gapmes.service.errors import ModelError
from gapmes.service.kernels import warm_up
from gapmes.service.network.engine import Engine
from gapmes.service.process import compiler_pages
from gapmes.service.process.compiler_pages import code_as_in_its_file
from gapmes.service.reconstruct import Reconstructor

RESIDENT = """
import json
from pathlib import Path
import numba
from gapmes.service.process.allocator import give_back_freed
from gapmes.service.process.compiler_pages import code_as_in_its_file, leave_compiler
from gapmes.service.kernels import warm_up

def resident():
    return sum(part[2] for part in code_as_in_its_file(Path("/proc/self/smaps").read_text()))

give_back_freed()
"""
COMPILING = """
numba.njit(lambda x: x + 1)(1)
before = resident()
left = leave_compiler()
after = resident()
again = numba.njit(lambda x: 3 * x)(14)  # compiles
print(json.dumps([before, left, after, again, resident()]))
"""
WARM = """
before = resident()
warm_up()
print(json.dumps([before, resident()]))
"""
MAPPING = """7f0000000000-7f0000400000 {rights} 00300000 fe:00 123                        {path}
Size:               4096 kB
Rss:                2048 kB
Private_Dirty:         0 kB
{written}:                 {kilobytes} kB
THPeligible:           0
VmFlags: rd ex mr mw me
"""
PATH = "/a folder/llvmlite/binding/libllvmlite.so"


def numbers_of(program: str) -> list[float]:
    """The numbers that a separate process prints."""
    command = [sys.executable, "-c", RESIDENT + program]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True, timeout=300).stdout)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads Linux's /proc")
def test_pages_go_and_come_back() -> None:
    before, left, after, again, at_last = numbers_of(COMPILING)
    assert min(left, before) > 20e6  # of the 84 MB of llvmlite 0.50
    assert left == pytest.approx(before, rel=0.2)
    assert after < 0.2 * before
    assert again == 42
    assert at_last > after


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads Linux's /proc")
def test_whoever_has_the_loops_is_rid_of_them() -> None:
    warm_up()  # here, so that the other process finds them compiled
    before, after = numbers_of(WARM)
    assert before > 20e6
    assert after < 0.2 * before


def test_they_are_not_in_memory_beside_the_network(
    engine: Engine, plane_scene: PlaneScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    order: list[str] = []

    def stop(*_: object) -> None:
        order.append("network")
        raise ModelError("far enough")

    monkeypatch.setattr(reconstruct, "is_warm", lambda: False)
    monkeypatch.setattr(reconstruct, "leave_compiler", lambda: order.append("left"))
    monkeypatch.setattr(Reconstructor, "run_network", stop)
    with pytest.raises(ModelError, match="far enough"):
        Reconstructor(engine).reconstruct(
            plane_scene.images, plane_scene.cameras, near=plane_scene.near, far=plane_scene.far
        )
    assert order == ["left", "network"]


def test_a_process_that_keeps_its_memory_keeps_these(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiler_pages, "gives_back", lambda: False)
    assert compiler_pages.leave_compiler() == 0


@pytest.mark.parametrize(
    ("rights", "path", "written", "kilobytes", "taken"),
    [
        ("r-xp", PATH, "Anonymous", 0, True),
        ("r-xp", PATH.replace(".so", "-0a1b2c.so.20"), "Anonymous", 0, True),
        ("r-xp", PATH.replace("a folder", "odd\udcff\x85"), "Anonymous", 0, True),
        ("r-xp", PATH, "Anonymous", 4, False),  # written to, as by a debugger
        ("r-xp", PATH, "Anonymous:           0 kB\nSwap", 4, False),
        ("r-xp", PATH, "Private_Clean", 0, False),  # not told whether it was written to
        ("r--p", PATH, "Anonymous", 0, False),
        ("rw-p", PATH, "Anonymous", 0, False),
        ("r-xp", "/usr/lib/libllvmlite/libc.so.6", "Anonymous", 0, False),
        ("r-xp", "", "Anonymous", 0, False),
    ],
)
def test_only_code_as_it_is_in_its_file_is_taken(
    rights: str, path: str, written: str, kilobytes: int, taken: bool
) -> None:
    other = MAPPING.format(rights="r-xp", path="/usr/lib/libc.so.6", written="Anonymous", kilobytes=0)
    smaps = other + MAPPING.format(rights=rights, path=path, written=written, kilobytes=kilobytes) + other
    expected = [(0x7F0000000000, 4 << 20, 2 << 20)] if taken else []
    assert list(code_as_in_its_file(smaps)) == expected
    assert list(code_as_in_its_file(smaps.removesuffix(other))) == expected
