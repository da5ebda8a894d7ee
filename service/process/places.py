"""What an output path leads to: a file, which can be replaced, or a pipe, device or open stream."""

from __future__ import annotations

import errno
import os
import re
import stat
from pathlib import Path
from typing import BinaryIO

MOUNTS = Path("/proc/self/mountinfo")
MOST_LINKS = 40  # symbolic links that the system follows
_OPEN_FILES = re.compile(r"/proc/\d+(/task/\d+)?/fd|/dev/fd")  # folders of the open files of a process, by descriptor


def resolved(path: Path) -> Path:
    """The path with all symbolic links resolved. Raises `OSError` for a loop."""
    try:
        path.stat()
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise
    return path.resolve()


def open_file(path: Path) -> Path | None:
    """The entry in /proc/<pid>/fd or /dev/fd that the path leads to, None if it leads to no such entry."""
    for _ in range(MOST_LINKS):
        here = Path(os.path.realpath(path.parent)) / path.name
        if _OPEN_FILES.fullmatch(str(here.parent)):
            return here
        if not here.is_symlink():
            return None
        path = here.parent / here.readlink()
    return None


def takes_bytes(path: Path) -> bool:
    """Whether the path is a pipe, a device or an open stream such as /dev/stdout, which is written to and not
    replaced."""
    return open_file(path) is not None or (path.exists() and not path.is_file())


def open_taking(path: Path) -> BinaryIO:
    """Open such a path for writing. An open stream continues at its position, without truncating its file."""
    entry = open_file(path)
    if entry is None:
        return path.open("wb")
    if entry.parent == Path("/dev/fd") or entry.is_relative_to(f"/proc/{os.getpid()}"):
        return os.fdopen(os.dup(int(entry.name)), "wb")
    return path.open("ab")


def is_stdout(path: Path) -> bool:
    """Whether the path is the file or pipe that stdout leads to; False for devices, where it does not matter."""
    try:
        ours, there = os.fstat(1), path.stat()
    except OSError:
        return False
    return os.path.samestat(ours, there) and not stat.S_ISCHR(ours.st_mode)


def is_mounted(path: Path) -> bool:
    """Whether this file is a mount point, as when it is bind-mounted into a container: it cannot be replaced."""
    try:
        mounts = MOUNTS.read_text(encoding="utf-8", errors="surrogateescape").split("\n")
    except OSError:
        return False
    escaped = "".join(f"\\{ord(letter):03o}" if letter in " \t\n\\" else letter for letter in str(path))
    return any(line.split(" ")[4:5] == [escaped] for line in mounts)
