"""The standard streams, also where the caller has closed one, or where what it leads to takes no more."""

from __future__ import annotations

import json
import os
import sys
from typing import Any, TextIO


def open_missing() -> None:
    """Those that the caller has closed lead nowhere from now on, here and in processes that are started from here.

    Otherwise Python has None in their place, and the system gives their numbers to the files that are opened next.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            handle = os.open(os.devnull, os.O_RDWR)  # has the lowest number that is free
            os.set_inheritable(handle, handle == number)
            setattr(sys, name, os.fdopen(handle, "r" if number == 0 else "w", encoding="utf-8", closefd=False))


def write_result(document: Any) -> None:
    """A document to stdout, as a line of JSON. Raises `OSError` where that cannot be written."""
    write_to(sys.stdout, json.dumps(document, allow_nan=False) + "\n")


def write_to(stream: TextIO, text: str) -> None:
    """Text to stdout or stderr, with all that was written there before. Raises `OSError` where that cannot be written;
    then it is given up, so that it does not fail once more when the process ends."""
    try:
        stream.write(text)
        stream.flush()
    except OSError as error:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
        raise OSError(error.errno, error.strerror, "stdout" if stream is sys.stdout else "stderr") from error
