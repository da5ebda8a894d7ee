"""`gapmes-export --report` and `--stability`: measurements instead of an export."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import typer
from rich.console import Console

from gapmes.service.errors import InputError
from gapmes.service.process.output_file import check_output_folder
from gapmes.service.process.terminal import ProgressBars

from .memory import OutOfMemory, enough_memory

REFUSED = 1
FAILED = 3


def write_tables(
    report: Path | None, stability: Path | None, scenes: Sequence[Path], quick: bool, *, as_json: bool, quiet: bool
) -> None:
    """Run the measurements that have a folder; `as_json` prints a summary, or a refusal, to stdout.

    Exit status 1 for a folder that cannot be made, one that is no scene, lack of memory, and where a process of the
    report fails; 3 where a case is beyond its tolerance.
    """
    from .tradeoff.child import ChildFailed

    try:
        for folder, field in ((stability, "stability"), (report, "report")):  # both before any work
            if folder is not None:
                check_output_folder(folder, field=field)
        document, failed = _measured(report, stability, scenes, quick, quiet)
    except (ChildFailed, InputError, OutOfMemory, OSError) as error:
        Console(stderr=True, soft_wrap=True).print(f"refused: {error}", markup=False)
        if as_json:
            typer.echo(json.dumps({"error": {"detail": str(error)}}))
        raise typer.Exit(REFUSED) from error
    if as_json:
        typer.echo(json.dumps(document))
    if failed:
        raise typer.Exit(FAILED)


def _measured(
    report: Path | None, stability: Path | None, scenes: Sequence[Path], quick: bool, quiet: bool
) -> tuple[dict[str, Any], int]:
    """A summary of the measurements, and the number of cases beyond tolerance."""
    from gapmes.model.training.lpips import default_weights
    from gapmes.service.shipped import sample_folder

    failed = 0
    document: dict[str, Any] = {}
    with ProgressBars(quiet=quiet) as bars:
        if stability is not None:
            from .stability.table import stability_table

            with enough_memory("compute the table of stability", "take a machine with more memory"):
                rows = stability_table(stability, bars)
            failed = sum(not row.passed for row in rows)
            bars.say(f"{len(rows)} cases, {failed} beyond tolerance: {stability / 'stability.md'}")
            document["stability"] = {"folder": str(stability), "cases": len(rows), "beyond_tolerance": failed}
        if report is not None:
            from .tradeoff.child import CURE
            from .tradeoff.run import report as measure

            with enough_memory("measure the report", CURE):
                found = measure([sample_folder(), *scenes], report, quick=quick, lpips=default_weights(), listener=bars)
            bars.say(
                f"{len(found.rows)} settings in {found.seconds:.0f} s: {report / 'report.md'}, {report / 'pareto.png'}"
            )
            document["report"] = {"folder": str(report), "settings": len(found.rows), "seconds": found.seconds}
    return document, failed
