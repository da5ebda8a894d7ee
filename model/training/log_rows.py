"""Reads the log of a training run, also while it is being written."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Rows of a log of JSON lines, oldest first; a last line that is still being written is left out.

    Raises `ValueError` that names the first line without finite numbers `step` and `minutes`, or a file that is not
    UTF-8, and `OSError` for a missing one.
    """
    rows = []
    try:
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is no training log, it is no text: {error}") from error
    for number, line in enumerate((line for line in lines if line.endswith("\n")), start=1):
        try:
            row = json.loads(line)
            if not all(map(math.isfinite, (row["step"], row["minutes"]))):
                raise ValueError("step and minutes have to be finite")
        except (ValueError, KeyError, TypeError, OverflowError) as error:
            raise ValueError(f"{path}, line {number} is no row of a training log: {error!r}") from error
        rows.append(row)
    return rows
