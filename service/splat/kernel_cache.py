"""The one decorator of every numba kernel, and the choice of a writable folder for their compiled code.

Compiling all kernels takes seconds; loading them takes a tenth. Numba writes its cache next to the source, or else into
the user's cache folder, and fails when neither can be written (a container with a read-only root and no home).
"""

from __future__ import annotations

import os
import stat
import tempfile
from collections.abc import Callable
from pathlib import Path

import numba

PACKAGE = Path(__file__).resolve().parent


def cache_folder(package: Path = PACKAGE) -> Path | None:
    """Where compiled kernels go; None leaves the choice to numba (NUMBA_CACHE_DIR is set, or the package is writable).

    Otherwise the first of these that can be written and belongs to this user alone: $XDG_CACHE_HOME/gapmes,
    ~/.cache/gapmes, <temporary folder>/gapmes-<user id>; if none can, a fresh private temporary folder.
    """
    if os.environ.get("NUMBA_CACHE_DIR") or _is_private(package / "__pycache__", create=package):
        return None
    caches = [Path(value) for value in (os.environ.get("XDG_CACHE_HOME"),) if value]
    home = os.path.expanduser("~")
    if home != "~":
        caches.append(Path(home) / ".cache")
    user = os.getuid() if hasattr(os, "getuid") else 0
    candidates = [cache / "gapmes" for cache in caches] + [Path(tempfile.gettempdir()) / f"gapmes-{user}"]
    for folder in candidates:
        if _is_private(folder, create=folder.parent):
            return folder
    return Path(tempfile.mkdtemp(prefix="gapmes-"))


def _is_private(folder: Path, *, create: Path) -> bool:
    """Whether `folder` is ours to write; it is made (mode 0700) if missing. `create` is what must be writable for that.

    Cached kernels are executed when loaded, so a folder of somebody else, or one that others may write, is no cache.
    """
    try:
        if not folder.exists():
            if not create.exists():
                create.mkdir(mode=0o700, parents=True)
            folder.mkdir(mode=0o700)
        status = folder.stat()
    except OSError:
        return False
    if hasattr(os, "getuid") and (status.st_uid != os.getuid() or status.st_mode & stat.S_IWOTH):
        return False
    return os.access(folder, os.W_OK | os.X_OK)


_folder = cache_folder()
if _folder is not None:
    numba.config.CACHE_DIR = str(_folder)


def kernel(*, fastmath: frozenset[str] = frozenset()) -> Callable[[Callable], Callable]:
    """Compile on first call, keep on disk, release the interpreter lock while running.

    Without `fastmath` the arithmetic is IEEE: the result does not depend on where in an array a Gaussian stands, nor on
    how the compiler vectorises. NaN and infinity must never be assumed away: that would delete the very tests for them.
    """
    if fastmath & {"fast", "nnan", "ninf"}:
        raise ValueError(f"fastmath {sorted(fastmath)} would delete the tests for NaN and infinity")
    return numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=set(fastmath))
