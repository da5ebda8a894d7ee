"""`gapmes doctor`: what is installed and whether it works here, with a verdict in one line."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from ..backends.choice import ENGINES, checked_engine


def doctor(
    model: Annotated[Path | None, typer.Option(help="ONNX model [default: GAPMES_MODEL or the packaged one]")] = None,
    engine: Annotated[
        str | None, typer.Option(help=f"what computes the network: {', '.join(ENGINES)} [default: GAPMES_ENGINE]")
    ] = None,
    store: Annotated[Path | None, typer.Option(help="folder of the scenes [default: GAPMES_STORE]")] = None,
    threads: Annotated[int | None, typer.Option(min=1, max=1024, help="CPU threads [default: all]")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="print the findings to stdout as one JSON object")] = False,
) -> None:
    """Look at versions, processor, threads, memory, model, kernels and store, and reconstruct the sample."""
    from rich.console import Console

    from ..doctor import Doctor, verdict
    from ..settings import Settings

    given: dict[str, Any] = {
        "model": model,
        "engine": None if engine is None else checked_engine(engine),
        "store": store,
        "threads": threads,
    }
    settings = Settings(**{name: value for name, value in given.items() if value is not None})
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    findings = []
    for finding in Doctor(settings).findings():
        findings.append(finding)
        console.print(f"{finding.state:8} {finding.name:10} {finding.text}", markup=False)
    said = verdict(findings)
    console.print(said, markup=False)
    if as_json:
        document = {"verdict": said, "findings": [asdict(finding) for finding in findings]}
        sys.stdout.write(json.dumps(document) + "\n")
    if any(finding.state == "failure" for finding in findings):
        raise typer.Exit(1)
