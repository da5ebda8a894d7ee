"""`gapmes doctor`: check the installation and the machine, with a verdict in one line."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from ..network.backends.choice import ENGINES, checked_engine
from ..process.streams import write_result
from ..process.terminal import ProgressBars, Quiet
from .given import Threads, given, path_option


def doctor(
    model: Annotated[Path | None, path_option("ONNX model [default: GAPMES_MODEL or the packaged one]")] = None,
    engine: Annotated[
        str | None, typer.Option(help=f"engine that runs the network: {', '.join(ENGINES)} [default: GAPMES_ENGINE]")
    ] = None,
    store: Annotated[Path | None, path_option("folder of the scenes [default: GAPMES_STORE]")] = None,
    threads: Threads = None,
    as_json: Annotated[bool, typer.Option("--json", help="print the findings to stdout as one JSON object")] = False,
    quiet: Quiet = False,
) -> None:
    """Look at versions, extras, processor, threads, memory, model, kernels, store, caches; reconstruct the sample."""
    from ..doctor import Doctor, verdict
    from ..progress import Stages
    from ..settings import checked_settings

    checked = checked_engine(engine) if engine else None
    settings = checked_settings(**given(model=model, engine=checked, store=store, threads=threads))
    examination = Doctor(settings)
    findings = []
    with ProgressBars(quiet=quiet) as bars:
        with Stages(bars).stage("doctor", len(examination.looks)) as step:
            for finding in examination.findings():
                findings.append(finding)
                bars.say(f"{finding.state:8} {finding.name:10} {finding.text}")
                step(len(findings))
        said = verdict(findings)
        bars.say(said)
    if as_json:
        document = {"verdict": said, "findings": [asdict(finding) for finding in findings]}
        write_result(document)
    if any(finding.state == "failure" for finding in findings):
        raise typer.Exit(1)
