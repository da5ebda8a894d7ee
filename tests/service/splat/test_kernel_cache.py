"""Compiled kernels find a writable folder of their own, and no kernel assumes that NaN is absent."""

import os
import subprocess
import sys
import threading
from collections.abc import Callable

import numba
import pytest

from gapmes.service import kernels
from gapmes.service.kernels import warm_up
from gapmes.service.splat import kernel_cache
from gapmes.service.splat.kernel_cache import KERNELS, cache_folder, given_refusal, kernel, source_stamp

KERNELS_OF_A_PROCESS = """
from gapmes.service.splat import blend, kernel_cache
found = [value for value in vars(blend).values() if hasattr(value, "signatures")]
print(kernel_cache.KERNELS, *{function.stats.cache_path for function in found}, sep="\\n")
"""


@pytest.fixture
def bare(monkeypatch, tmp_path):
    """No settings, a home of its own, and a package folder that cannot be written."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return tmp_path / "missing" / "package"


@pytest.fixture
def denied(monkeypatch):
    """`denied(path)` makes a folder refuse writes, also for root."""
    closed = []
    access, mkdir = os.access, os.mkdir

    def covers(path) -> bool:
        return any(str(path).startswith(str(folder)) for folder in closed)

    def refused_mkdir(path, *args, **kwargs):
        if covers(path):
            raise PermissionError(path)
        return mkdir(path, *args, **kwargs)

    monkeypatch.setattr(os, "access", lambda path, mode: not covers(path) and access(path, mode))
    monkeypatch.setattr(os, "mkdir", refused_mkdir)
    return closed.append


def test_the_setting_comes_first_and_then_the_package(monkeypatch, tmp_path, bare):
    assert cache_folder(tmp_path) == tmp_path / "__pycache__"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "told"))
    assert cache_folder(bare) == tmp_path / "told"


def test_a_named_folder_that_cannot_be_written_is_passed_over(monkeypatch, tmp_path, bare):
    (tmp_path / "file").write_text("no folder")
    told = tmp_path / "file" / "told"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(told))
    assert cache_folder(tmp_path) == tmp_path / "__pycache__"
    why = given_refusal(bare)
    assert why == f"NUMBA_CACHE_DIR: {told}/kernels-{source_stamp(bare)} cannot be written: Not a directory"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "other"))
    assert given_refusal(bare) is None
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    assert given_refusal(bare) is None


def test_kernels_have_their_own_folder_also_where_the_named_one_cannot_be_written(tmp_path):
    """Numba would keep them beside the source, where a change of another file leaves them as they are."""
    (tmp_path / "file").write_text("no folder")
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "file" / "told")}
    words = [sys.executable, "-c", KERNELS_OF_A_PROCESS]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
    kernels, *paths = done.stdout.splitlines()
    assert paths
    assert all(path.startswith(f"{kernels}{os.sep}") for path in paths)


ON_A_FULL_DISK = """
import resource, signal
from gapmes.service.splat import kernel_cache
@kernel_cache.kernel()
def twice(x):
    return 2 * x
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (500, resource.RLIM_INFINITY))
print(twice(21), kernel_cache.not_kept())
"""


def test_kernels_compute_where_they_cannot_be_kept(tmp_path):
    (tmp_path / "program.py").write_text(ON_A_FULL_DISK)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "told")}
    words = [sys.executable, tmp_path / "program.py"]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
    folder = tmp_path / "told" / f"kernels-{source_stamp()}"
    assert done.stdout == f"42 compiled kernels cannot be kept in {folder}: File too large\n"
    assert not list(folder.rglob("*.nbc*"))


def test_the_log_says_where_kernels_are_not_kept(monkeypatch, caplog):
    monkeypatch.setattr(kernels, "warm_up", lambda: kernel_cache._unkept.append(OSError(28, "No space left on device")))
    monkeypatch.setattr(kernel_cache, "_unkept", [])
    monkeypatch.setattr(kernels, "ELSEWHERE", "elsewhere")
    kernels.warm_up_with_notice()
    why = f"compiled kernels cannot be kept in {KERNELS}: No space left on device; the next start compiles them again"
    assert caplog.messages == ["elsewhere", why]


def test_every_state_of_the_sources_has_a_stamp_of_its_own(tmp_path):
    """A kernel compiles in what it calls in other files, which numba's own check does not see."""
    for name in ("kernel.py", "called.py"):
        (tmp_path / name).write_text("x = 1\n")
    before = source_stamp(tmp_path)
    assert before == source_stamp(tmp_path)
    (tmp_path / "called.py").write_text("x = 2\n")
    assert source_stamp(tmp_path) != before
    (tmp_path / "called.py").write_text("x = 1\n")
    assert source_stamp(tmp_path) == before


def test_kernels_go_where_the_stamp_says():
    assert KERNELS.name == f"kernels-{source_stamp()}"
    warm_up()
    assert list(KERNELS.rglob("*.nbi"))
    assert str(KERNELS) != numba.config.CACHE_DIR  # other users of numba keep their own


def test_kernels_decorated_at_once_leave_the_folder_of_others_alone(monkeypatch):
    """Threads import modules of kernels when they first need them; the one that ends last must not restore ours."""
    before, begun, ended = numba.config.CACHE_DIR, [threading.Event() for _ in range(2)], threading.Event()

    def njit(**_: object) -> Callable:
        def decorated(function: Callable) -> Callable:
            begun[functions.index(function)].set()
            (begun[1] if function is functions[0] else ended).wait(0.2)
            return function

        return decorated

    def decorate(function: Callable) -> None:
        kernel()(function)
        ended.set()

    functions = [lambda: 1, lambda: 2]
    monkeypatch.setattr(numba, "njit", njit)
    threads = [threading.Thread(target=decorate, args=(function,)) for function in functions]
    threads[0].start()
    assert begun[0].wait(120)
    threads[1].start()
    for thread in threads:
        thread.join()
    after, numba.config.CACHE_DIR = numba.config.CACHE_DIR, before
    assert after == before


def test_the_users_cache_folder_comes_next(monkeypatch, tmp_path, bare, denied):
    denied(bare)
    assert cache_folder(bare) == tmp_path / "home" / ".cache" / "gapmes"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    monkeypatch.setattr("tempfile.gettempdir", None)  # not asked: there may be none that can be written
    assert cache_folder(bare) == tmp_path / "xdg" / "gapmes"
    assert (tmp_path / "xdg" / "gapmes").stat().st_mode & 0o777 == 0o700


def test_a_container_without_a_home_uses_a_private_temporary_folder(tmp_path, bare, denied):
    denied(bare)
    denied(tmp_path / "home")
    expected = tmp_path / f"gapmes-{os.getuid()}"
    assert cache_folder(bare) == expected
    for mode in (0o777, 0o770):  # a folder that others may write could hold their code
        expected.chmod(mode)
        other = cache_folder(bare)
        assert other != expected
        assert other.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("flags", [{"nnan"}, {"ninf"}, {"fast", "contract"}])
def test_flags_that_delete_the_nan_tests_are_refused(flags):
    with pytest.raises(ValueError, match="NaN"):
        kernel(fastmath=frozenset(flags))
