"""Run every case of the stability table and write it as JSON and Markdown."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import asdict
from itertools import chain
from pathlib import Path

from gapmes.service.process.disk import replacing
from gapmes.service.process.output_file import check_output_file
from gapmes.service.progress import Listener, Stages, silent

from . import geometry, matching, routing, splatter
from .row import Row

CASES = 26


def stability_table(out: Path, listener: Listener = silent) -> list[Row]:
    """Write `out`/stability.json and stability.md; returns the rows. Raises `InputError` where that cannot be done,
    before any case is computed."""
    out.mkdir(parents=True, exist_ok=True)
    table, text = out / "stability.json", out / "stability.md"
    for path in (table, text):
        check_output_file(path, field="stability")
    found: list[Row] = []
    with Stages(listener).stage("stability", CASES) as done:
        for row in all_rows():
            found.append(row)
            done(len(found))
    body = {
        "passed": all(row.passed for row in found),
        "rows": [{**asdict(row), "passed": row.passed} for row in found],
    }
    with replacing(table) as part:
        part.write_text(json.dumps(_finite(body), indent=2, allow_nan=False) + "\n")
    with replacing(text) as part:
        part.write_text(markdown(found))
    return found


def all_rows() -> Iterator[Row]:
    """Case by case, as they are computed."""
    return chain(splatter.rows(), routing.rows(), matching.rows(), geometry.rows())


def markdown(rows: list[Row]) -> str:
    """A table; the naive column says what plain float32 gives in the same case."""
    lines = [
        "| case | what | sweep | right is | error | worst | allowed | plain float32 | which is |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        worst = f"{row.worst:.1e}" if row.passed else f"**{row.worst:.1e}**"
        naive = "" if row.naive is None else "not finite" if not math.isfinite(row.naive) else f"{row.naive:.1e}"
        lines.append(
            f"| {row.case} | {row.what} | {row.sweep} | {row.reference} | {row.unit} | {worst} | {row.tolerance:.1e} | "
            f"{naive} | {row.naive_is} |"
        )
    return "\n".join(lines) + "\n"


def _finite(value: object) -> object:
    """JSON has neither infinity nor NaN: they are written as text."""
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_finite(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return "not finite"
    return value
