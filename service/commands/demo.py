"""`gapmes demo`: reconstruct the packaged sample scene by a temporary service, as `make demo` does."""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from ..process.ending import SIGNALS
from ..process.streams import write_result
from ..process.terminal import ProgressBars, Quiet
from .given import output_option


def demo(
    output: Annotated[Path, output_option("folder for results", "-o", "--output")] = Path("demo"),
    keep: Annotated[
        bool, typer.Option("--keep", help="leave the service running [also: KEEP=1 in the environment]")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="print the result to stdout as one JSON object")] = False,
    quiet: Quiet = False,
) -> None:
    """Start the service, reconstruct the sample scene, render novel views and compare them with the truth."""
    from ..demo import run_demo
    from ..switch import switched_on

    for number in SIGNALS:
        if signal.getsignal(number) != signal.SIG_IGN:  # ignored under nohup
            signal.signal(number, _unwound)
    keep = keep or switched_on("KEEP")
    with ProgressBars(quiet=quiet) as bars:
        result = run_demo(output, bars, keep=keep)
    scores = ", ".join(f"{score:.1f}" for score in result.psnr)
    bars.say(f"PSNR of the novel views: {scores} dB")
    for path in result.files:
        bars.say(f"wrote {path}")
    if keep:
        bars.say(f"the page stays at {result.address}/ ; stop it with: kill {result.pid}")
    else:
        bars.say(f"the page was at {result.address}/ ; KEEP=1 make demo keeps it running")
    if as_json:
        document = {
            "scene": result.scene_id,
            "address": result.address,
            "pid": result.pid if keep else None,
            "psnr_db": result.psnr,
            "files": [str(path) for path in result.files],
        }
        write_result(document)


def _unwound(number: int, _: Any) -> None:
    """Exit by an exception, so that the service is stopped too; further signals are ignored."""
    for each in SIGNALS:
        signal.signal(each, signal.SIG_IGN)
    sys.exit(128 + number)
