"""The standard streams, also where the caller has closed one, or where what it leads to takes no more; and how text
from files of others is shown on them."""

from __future__ import annotations

import json
import os
import re
import sys
from typing import Any, TextIO

# Control characters, line ends, and what turns the direction of writing (Unicode, UAX #9): a terminal obeys them.
_UNSEEN = re.compile("[\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028\u2029\u202a-\u202e\u2066-\u2069]")


def visible(text: str) -> str:
    """The text in one line, with what a terminal would obey rather than show written as in a Python string."""
    return _UNSEEN.sub(lambda found: repr(found[0])[1:-1], text.replace("\n", " "))


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
