"""Where a path leads that is to be written to: to a file, whose place another may take, or to what takes bytes."""

from __future__ import annotations

import errno
import os
import re
import stat
from pathlib import Path
from typing import BinaryIO

MOUNTS = Path("/proc/self/mountinfo")
MOST_LINKS = 40  # that the system follows
_OPEN_FILES = re.compile(r"/proc/\d+(/task/\d+)?/fd|/dev/fd")  # folders of what a process has open, by number


def resolved(path: Path) -> Path:
    """The path behind all links. Raises `OSError` where they lead in a circle."""
    try:
        path.stat()
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise
    return path.resolve()


def open_file(path: Path) -> Path | None:
    """The entry among the open files of a process that the path leads to, None where it leads to none."""
    for _ in range(MOST_LINKS):
        here = Path(os.path.realpath(path.parent)) / path.name
        if _OPEN_FILES.fullmatch(str(here.parent)):
            return here
        if not here.is_symlink():
            return None
        path = here.parent / here.readlink()
    return None


def takes_bytes(path: Path) -> bool:
    """Whether it is a pipe, a device or a stream that is open, such as /dev/stdout, whatever that leads to: no file
    whose place another could take."""
    return open_file(path) is not None or (path.exists() and not path.is_file())


def open_taking(path: Path) -> BinaryIO:
    """Such a place, to write to. A stream that is open goes on from where it is, and nothing in its file is lost."""
    entry = open_file(path)
    if entry is None:
        return path.open("wb")
    if entry.parent == Path("/dev/fd") or entry.is_relative_to(f"/proc/{os.getpid()}"):
        return os.fdopen(os.dup(int(entry.name)), "wb")
    return path.open("ab")


def is_stdout(path: Path) -> bool:
    """Whether it is the file or the pipe that stdout leads to; of devices it does not matter."""
    try:
        ours, there = os.fstat(1), path.stat()
    except OSError:
        return False
    return os.path.samestat(ours, there) and not stat.S_ISCHR(ours.st_mode)


def is_mounted(path: Path) -> bool:
    """Whether this very file, no link, is a mount, as one that a container is given: no other can take its place."""
    try:
        mounts = MOUNTS.read_text(encoding="utf-8", errors="surrogateescape").split("\n")
    except OSError:
        return False
    escaped = "".join(f"\\{ord(letter):03o}" if letter in " \t\n\\" else letter for letter in str(path))
    return any(line.split(" ")[4:5] == [escaped] for line in mounts)
