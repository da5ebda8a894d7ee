"""`gapmes-export`: a checkpoint of the network to a verified ONNX file."""

from __future__ import annotations

import json
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import Annotated, cast

import typer
from rich.console import Console
from rich.markup import escape

from gapmes.model.architectures import ARCHITECTURES
from gapmes.model.checkpoint import read_config, shipped_checkpoint
from gapmes.model.config import PRESETS
from gapmes.model.depthsplat.config import LARGEST_SCALE, SCALE_MIN, Compatibility
from gapmes.model.weights_file import CheckpointError
from gapmes.service.commands.given import output_option
from gapmes.service.errors import InputError
from gapmes.service.process.ending import ended_in_order
from gapmes.service.process.terminal import ProgressBars, Quiet

from .measurements import write_tables
from .memory import OutOfMemory
from .model_file import data_files
from .pipeline import Exported, ExportRejected, VerificationBroken, export_checkpoint
from .size import Size
from .tolerance import TOLERANCES, Precision
from .variant import Variant

REFUSED = 1
REJECTED = 3

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode="markdown")
errors = Console(stderr=True)


@app.command()
def export(
    out: Annotated[Path | None, output_option("Path of the .onnx file to write.", "--out", "-o")] = None,
    architecture: Annotated[str, typer.Option(help=f"One of {', '.join(ARCHITECTURES)}.")] = "gapmes",
    preset: Annotated[
        str | None,
        typer.Option(help=f"Preset of gapmes: one of {', '.join(PRESETS)} [default: tiny, or the checkpoint's]."),
    ] = None,
    checkpoint: Annotated[
        Path | None,
        typer.Option(
            help="A .safetensors checkpoint of ours (default: the shipped one), or a published DepthSplat .pth."
        ),
    ] = None,
    size: Annotated[
        str | None,
        typer.Option(
            help="HEIGHTxWIDTH in pixels, or one side; at least 32, multiples of 16, of 32 for some DepthSplat networks"
            " [default: 256x256]."
        ),
    ] = None,
    precision: Annotated[str | None, typer.Option(help=f"One of {', '.join(TOLERANCES)} [default: fp32].")] = None,
    top_k: Annotated[int | None, typer.Option(help="Experts per patch, at most all [default: as trained].")] = None,
    keep_all: Annotated[
        bool, typer.Option("--keep-all", help="Run every expert on every patch and match every pair of views.")
    ] = False,
    compatibility: Annotated[
        str | None,
        typer.Option(help="For depthsplat: none, authors (as in their code), or switches by name [default: none]."),
    ] = None,
    scale_max: Annotated[
        float | None,
        typer.Option(
            help="For depthsplat: largest Gaussian, in its units [default: the published weights' own, else 3]."
        ),
    ] = None,
    quick: Annotated[bool, typer.Option(help="Verify at two view counts instead of five; shorten --report.")] = False,
    report: Annotated[
        Path | None,
        output_option("Export nothing: write a report of error against run time of every setting into this folder."),
    ] = None,
    stability: Annotated[
        Path | None, output_option("Export nothing: write the table of stiff and extreme cases into this folder.")
    ] = None,
    scene: Annotated[
        list[Path] | None,
        typer.Option(help="Scene folder for --report, in addition to the sample scene; repeat for several."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON on stdout.")] = False,
    quiet: Quiet = False,
) -> None:
    """Export, verify against torch in a separate process, and write OUT with its report beside it.

    With --json refusals and rejections are printed as well, as {"error": {"detail": ...}}.

    Exit status: 0 accepted; 1 refused (checkpoint, size, memory, disk); 2 wrong usage; 3 beyond tolerance, in which
    case the file is kept as NAME.rejected.onnx and OUT is left as it was.
    """
    if report is None and scene:
        raise typer.BadParameter("goes with --report", param_hint="--scene")
    if quick and scene:
        raise typer.BadParameter("is not measured with --quick, which has the sample scene alone", param_hint="--scene")
    if report is not None or stability is not None:
        given: dict[str, object] = {
            "--out": out,
            "--checkpoint": checkpoint,
            "--preset": preset,
            "--size": size,
            "--precision": precision,
            "--top-k": top_k,
            "--keep-all": keep_all,
            "--quick": quick and report is None,
            "--compatibility": compatibility,
            "--scale-max": scale_max,
            "--architecture": architecture != "gapmes",
        }
        if wrong := [name for name, value in given.items() if value is not None and value is not False]:
            raise typer.BadParameter(
                "nothing is exported with --report and --stability, which measure the shipped network"
                if wrong[0] != "--quick"
                else "shortens --report; the table of --stability is always whole",
                param_hint=wrong[0],
            )
        write_tables(report, stability, scene or (), quick, as_json=as_json, quiet=quiet)
        return
    if out is None:
        raise typer.BadParameter("is missing", param_hint="--out")
    height, width = _size(size or "256x256")
    precision = precision or "fp32"
    _one_of(architecture, ARCHITECTURES, "--architecture")
    _one_of(preset or "tiny", PRESETS, "--preset")
    _one_of(precision, TOLERANCES, "--precision")
    if architecture == "depthsplat" and (top_k is not None or keep_all):
        raise typer.BadParameter("is of gapmes networks: depthsplat has no experts", param_hint="--top-k, --keep-all")
    try:
        source, variant = _what(architecture, preset, checkpoint, compatibility, scale_max)
        with ProgressBars(quiet=quiet) as bars:
            result = export_checkpoint(
                source,
                out,
                height=height,
                width=width,
                precision=cast(Precision, precision),
                variant=replace(variant, top_k=top_k, keep_all=keep_all),
                quick=quick,
                listener=bars,
            )
    except (InputError, VerificationBroken, OutOfMemory, ValueError, OSError) as error:
        errors.print(f"[red]refused:[/] {escape(str(error))}", soft_wrap=True)
        if as_json:
            typer.echo(json.dumps({"error": {"detail": str(error)}}))
        raise typer.Exit(REFUSED) from error
    except ExportRejected as rejected:
        errors.print(f"[red]rejected:[/] {escape(str(rejected))}", soft_wrap=True)
        for failure in rejected.failures[1:20]:
            errors.print(f"  {failure}", soft_wrap=True, markup=False)
        errors.print(f"file: {rejected.rejected}\nreport: {rejected.report_path}", soft_wrap=True, markup=False)
        if as_json:
            kept = {"rejected": str(rejected.rejected), "report": str(rejected.report_path)}
            typer.echo(json.dumps({"error": {"detail": str(rejected), "failures": rejected.failures, **kept}}))
        raise typer.Exit(REJECTED) from rejected
    _show(result, as_json, bars)


def _one_of(value: str, choices: Collection[str], option: str) -> None:
    if value not in choices:
        raise typer.BadParameter(f"{value!r} is unknown, choose one of {', '.join(choices)}", param_hint=option)


def _what(
    architecture: str, preset: str | None, checkpoint: Path | None, compatibility: str | None, scale_max: float | None
) -> tuple[Path, Variant]:
    """The checkpoint to export, and the variant of its network. Raises `CheckpointError`."""
    if architecture == "depthsplat":
        if checkpoint is None:
            raise typer.BadParameter("depthsplat needs the path of a checkpoint", param_hint="--checkpoint")
        if preset is not None:
            raise typer.BadParameter(
                "is of gapmes networks: depthsplat's checkpoint tells its size", param_hint="--preset"
            )
        try:
            switches = Compatibility.named(compatibility or "none")
        except ValueError as error:
            raise typer.BadParameter(str(error), param_hint="--compatibility") from error
        if scale_max is not None and not SCALE_MIN < scale_max <= LARGEST_SCALE:
            raise typer.BadParameter(
                f"is {scale_max:g}, need a length above 0, of {SCALE_MIN:g} to {LARGEST_SCALE:g} units of the network",
                param_hint="--scale-max",
            )
        return checkpoint, Variant(architecture=architecture, compatibility=switches, scale_max=scale_max)
    for option, value in (("--compatibility", compatibility), ("--scale-max", scale_max)):
        if value is not None:
            raise typer.BadParameter("goes with --architecture depthsplat", param_hint=option)
    source = checkpoint or shipped_checkpoint(preset or "tiny")
    found = read_config(source).preset
    if preset is not None and found != preset:
        raise CheckpointError(f"{source} holds preset {found!r}, asked for {preset!r}")
    return source, Variant()


def _size(text: str) -> Size:
    try:
        return Size.parse(text)
    except InputError as error:
        error.field = None  # the hint names it
        raise typer.BadParameter(str(error), param_hint="--size") from error


def _show(result: Exported, as_json: bool, bars: ProgressBars) -> None:
    worst = result.report.worst()
    if as_json:
        body = {
            "model": str(result.model),
            "weights": [str(path) for path in data_files(result.model)],
            "report": str(result.report_path),
            "sha256": result.report.model_sha256,
            "checkpoint": None if result.fit_path is None else str(result.fit_path),
            "cases": len(result.report.cases),
            "worst": worst,
            "seconds": result.timings,
        }
        typer.echo(json.dumps(body))
        return
    files = [result.model, *data_files(result.model)]
    megabytes = sum(path.stat().st_size for path in files) / 1e6
    bars.say(f"{' + '.join(map(str, files))}  ({megabytes:.1f} MB), {len(result.report.cases)} cases passed")
    if result.fit is not None:
        first, *rest = result.fit.summary()
        for line in (f"checkpoint: {first}", *(f"  {line}" for line in rest), f"  each tensor: {result.fit_path}"):
            bars.say(line)
    bars.say("largest error of every output, in units of its largest value:")
    for name, value in worst.items():
        bars.say(
            f"  {name:15s} p99 {value['p99']:.1e}  mean {value['mean']:.1e}  "
            f"max {value['max']:.1e}  jumps {value['jumps']:.1e}"
        )


def main() -> None:
    """Entry point of `gapmes-export`."""
    with ended_in_order():
        app()


if __name__ == "__main__":
    main()
