"""The decorator of all numba kernels, and the folder in which their compiled code is cached.

Compiling all kernels takes seconds; loading them takes a tenth. Numba caches next to the source or in the user's cache
folder, and fails where neither can be written (a container with a read-only root and no home). It also considers a
cached kernel current while the kernel's own file is unchanged, although functions from other files are compiled into
it: so each state of this package's sources has a folder of its own. A kernel outside the package may call only
functions of its own file and of this package.
"""

from __future__ import annotations

import hashlib
import os
import stat
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import llvmlite
import numba

PACKAGE = Path(__file__).resolve().parent
_decorating = threading.Lock()  # numba's options belong to the whole process


def source_stamp(package: Path = PACKAGE) -> str:
    """12 hexadecimal digits, a digest of the package's sources and the compiler's versions."""
    digest = hashlib.sha256(f"{numba.__version__} {llvmlite.__version__}".encode())
    for path in sorted(package.glob("*.py")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:12]


def cache_folder(package: Path = PACKAGE) -> Path:
    """The folder that holds the compiled kernels of all states of the package.

    NUMBA_CACHE_DIR where it is set and can be written; else the first of these that is writable by this user alone: the
    package's __pycache__, $XDG_CACHE_HOME/gapmes, ~/.cache/gapmes, <temporary folder>/gapmes-<user id>; else a new
    private temporary folder.
    """
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given and given_refusal(package) is None:
        return Path(given)
    if _is_private(package / "__pycache__", create=package):
        return package / "__pycache__"
    caches = [Path(value) for value in (os.environ.get("XDG_CACHE_HOME"),) if value]
    home = os.path.expanduser("~")
    if home != "~":
        caches.append(Path(home) / ".cache")
    for cache in caches:
        if _is_private(cache / "gapmes", create=cache):
            return cache / "gapmes"
    temporary = Path(tempfile.gettempdir()) / f"gapmes-{os.getuid() if hasattr(os, 'getuid') else 0}"
    if _is_private(temporary, create=temporary.parent):
        return temporary
    return Path(tempfile.mkdtemp(prefix="gapmes-"))


def given_refusal(package: Path = PACKAGE) -> str | None:
    """Why the folder that NUMBA_CACHE_DIR names cannot hold kernels; None where it can, or where none is named.

    Tried as numba tries it: it would pass over such a folder without a word, for one without a stamp, or refuse to
    decorate any function.
    """
    given = os.environ.get("NUMBA_CACHE_DIR")
    if not given:
        return None
    folder = _of_this_state(Path(given), package)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        return f"NUMBA_CACHE_DIR: {folder} cannot be written: {error.strerror}"
    return None


def _of_this_state(folder: Path, package: Path) -> Path:
    """The folder's part for the present state of the package."""
    return folder / f"kernels-{source_stamp(package)}"


def _is_private(folder: Path, *, create: Path) -> bool:
    """Whether `folder` belongs to this user and is writable by nobody else; a missing one is made, with mode 0700.

    Its parent `create` is made too where it is missing. Cached kernels are executed when loaded, so a folder that
    others own or may write is not used.
    """
    try:
        if not folder.exists():
            if not create.exists():
                create.mkdir(mode=0o700, parents=True)
            folder.mkdir(mode=0o700)
        status = folder.stat()
    except OSError:
        return False
    if hasattr(os, "getuid") and (status.st_uid != os.getuid() or status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)):
        return False
    return os.access(folder, os.W_OK | os.X_OK)


KERNELS = _of_this_state(cache_folder(), PACKAGE)
_REFUSAL = given_refusal()
ELSEWHERE = None if _REFUSAL is None else f"{_REFUSAL}; compiled kernels are kept in {KERNELS}"


_unkept: list[OSError] = []


def not_kept() -> str | None:
    """Why compiled code could not be written into its folder, as on a full disk; None where all could until now."""
    return f"compiled kernels cannot be kept in {KERNELS}: {_unkept[0].strerror}" if _unkept else None


def _kept_where_possible(decorated: Any) -> Any:
    """The kernel, which is computed with also where numba cannot write what it has compiled."""
    if hasattr(decorated, "_cache"):  # not with NUMBA_DISABLE_JIT
        save = decorated._cache.save_overload

        def save_if_possible(*compiled: Any) -> None:
            try:
                save(*compiled)
            except OSError as error:
                _unkept.append(error)

        decorated._cache.save_overload = save_if_possible
    return decorated


def kernel(*, fastmath: frozenset[str] = frozenset()) -> Callable[[Callable], Callable]:
    """Compile on first call, cache on disk where that is possible, release the GIL while running.

    Without `fastmath` the arithmetic is IEEE: results depend neither on a Gaussian's position in an array nor on
    vectorisation. Raises `ValueError` for flags that assume finite numbers: they would remove the tests for NaN and
    infinity.
    """
    if fastmath & {"fast", "nnan", "ninf"}:
        raise ValueError(f"fastmath {sorted(fastmath)} would delete the tests for NaN and infinity")
    options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": set(fastmath)}
    options["no_cfunc_wrapper"] = True  # nothing calls them from C; numba's stub does not know this option

    def compiled(function: Callable) -> Callable:
        config: Any = numba.config  # its options are defined at run time
        with _decorating:
            others = config.CACHE_DIR
            config.CACHE_DIR = str(KERNELS)  # read when a function is decorated, and meant for these alone
            try:
                return _kept_where_possible(numba.njit(**options)(function))
            finally:
                config.CACHE_DIR = others

    return compiled
