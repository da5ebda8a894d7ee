"""The standard streams when they are closed or cannot be written, and escaping of untrusted text for terminals."""

from __future__ import annotations

import json
import os
import re
import sys
from typing import Any, TextIO

# Control characters, line separators and bidirectional controls (Unicode, UAX #9), which terminals interpret.
_UNSEEN = re.compile("[\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028\u2029\u202a-\u202e\u2066-\u2069]")


def visible(text: str) -> str:
    """The text in one line, with control characters escaped as in a Python string."""
    return _UNSEEN.sub(lambda found: repr(found[0])[1:-1], text.replace("\n", " "))


def open_missing() -> None:
    """Open /dev/null for every standard stream that is closed, in this process and those that it starts.

    Otherwise the stream would be None in Python, and its descriptor would be given to the next file that is opened.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            handle = os.open(os.devnull, os.O_RDWR)  # gets the lowest free descriptor, which is `number`
            os.set_inheritable(handle, handle == number)
            setattr(sys, name, os.fdopen(handle, "r" if number == 0 else "w", encoding="utf-8", closefd=False))


def write_result(document: Any) -> None:
    """Write a document to stdout as a line of JSON. Raises `OSError`."""
    write_to(sys.stdout, json.dumps(document, allow_nan=False) + "\n")


def write_to(stream: TextIO, text: str) -> None:
    """Write text to stdout or stderr and flush. On `OSError` the stream is redirected to /dev/null, so that it does not
    fail again at exit, and the error is raised with the stream's name."""
    try:
        stream.write(text)
        stream.flush()
    except OSError as error:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
        raise OSError(error.errno, error.strerror, "stdout" if stream is sys.stdout else "stderr") from error
