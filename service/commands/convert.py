"""`gapmes convert`: convert a file of Gaussians to another format, and measure the loss."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..process.streams import write_result
from ..process.terminal import ProgressBars, Quiet
from .dialect_options import (
    AxesOption,
    DropInvalidOption,
    OpacityOption,
    RotationOption,
    ScalesOption,
    SourceFormatOption,
)
from .given import Threads, output_path

if TYPE_CHECKING:
    from ..cameras.camera import Camera
    from ..gaussians import Gaussians
    from ..viewpoints.scene_views import SceneViews

AROUND = ("0", "orbit:-30", "orbit:30")  # views that are compared, of the default framing


def convert(
    source: Annotated[Path, typer.Argument(metavar="IN", readable=False, help=".ply, .compressed.ply, .splat or .spz")],
    output: Annotated[
        Path,
        typer.Argument(metavar="OUT", parser=output_path, help="file to write; its extension determines the format"),
    ],
    to: Annotated[str | None, typer.Option(help="format of OUT, if its extension does not tell")] = None,
    source_format: SourceFormatOption = None,
    opacity: OpacityOption = "auto",
    scales: ScalesOption = "auto",
    rotation: RotationOption = "auto",
    axes: AxesOption = "rub",
    drop_invalid: DropInvalidOption = False,
    measure: Annotated[
        str,
        typer.Option(metavar="CAMERAS|around|off", help="cameras from which pictures are compared; off: no comparison"),
    ] = "around",
    threads: Threads = None,
    as_json: Annotated[bool, typer.Option("--json", help="print what was written to stdout as JSON")] = False,
    quiet: Quiet = False,
) -> None:
    """Convert Gaussians between formats; says their count, the bytes, what was lost, and the PSNR of pictures."""
    from ..errors import InputError
    from ..formats.cost import picture_psnr
    from ..formats.dialect import STANDARD, Dialect
    from ..formats.registry import format_named, format_of_path, inspect_gaussians
    from ..process.disk import named, replace_file
    from ..process.output_file import check_output_file
    from ..progress import Stages
    from .input_file import capture_of_option, check_input_file

    cure = "end it in one of them, or give --to"
    target = format_of_path(output, field="OUT", cure=cure) if to is None else format_named(to, field="to")
    if not measure:
        raise InputError("is empty, need a camera file, around or off", field="measure", cure="leave it out for around")
    capture = None if measure in ("around", "off") else capture_of_option(Path(measure), "measure")
    cameras = None if capture is None else capture.cameras(range(len(capture.table.names))).cameras
    check_input_file(source, "IN", source_format)
    check_output_file(output, as_json=as_json)
    dialect = Dialect(opacity, scales, rotation, axes)
    with ProgressBars(quiet=quiet) as bars:
        stages = Stages(bars)
        with stages.stage("read"):
            data = source.read_bytes()  # once, since a pipe cannot be read again
            before = len(data)
            reading, found = inspect_gaussians(
                data, format=source_format, name=str(source), dialect=dialect, drop_invalid=drop_invalid
            )
            del data
        gaussians = reading.gaussians
        with stages.stage("convert"):
            encoded = target.write(gaussians)
        values: list[float | None] = []
        unmeasured: list[str] = []
        if measure != "off" and len(gaussians):
            kept = target.read(encoded.data, STANDARD, False, None).gaussians
            try:
                views, shots = _measured(gaussians, cameras)
                with stages.stage("measure", len(shots)) as step:
                    values = picture_psnr(gaussians, kept, shots, views.near_plane, threads=threads, step=step)
            except InputError as error:  # the file is written nevertheless
                unmeasured = [f"pictures could not be compared: {error}"]
        with named(output):
            replace_file(output, encoded.data)
    passed_over = [] if capture is None else [notice["message"] for notice in capture.table.warnings]
    if blind := [str(place) for place, value in enumerate(values) if value is None]:
        which = f"{', '.join(blind[:10])}{', …' if len(blind) > 10 else ''} of {len(values)}, counted from 0"
        unmeasured.append(f"nothing was compared where cameras see nothing of the Gaussians: {which}")
    empty = [] if reading.rows else [f"{source} holds no Gaussian: is it the right file, and whole?"]
    warnings = [*empty, *passed_over, *reading.notes(), *encoded.notes, *unmeasured]
    bars.say(
        f"{len(gaussians)} Gaussians in {output}: {len(encoded.data):,} bytes, "
        f"{len(encoded.data) / max(before, 1):.1%} of {before:,}"
    )
    if measured := [value for value in values if value is not None]:
        bars.say(f"pictures keep {min(measured):.1f} dB or more ({', '.join(f'{value:.1f}' for value in measured)})")
    for warning in warnings:
        bars.say(f"warning: {warning}")
    if as_json:
        document = {
            "from": {"file": str(source), "format": found.extension, "bytes": before, "rows": reading.rows},
            "to": {"file": str(output), "format": target.extension, "bytes": len(encoded.data)},
            "gaussians": {"count": len(gaussians), "sh_degree": gaussians.sh_degree},
            "psnr": values,
            "warnings": warnings,
            "timings": stages.timings,
        }
        write_result(document)


def _measured(gaussians: Gaussians, cameras: Sequence[Camera] | None) -> tuple[SceneViews, Sequence[Camera]]:
    """The scene's views and the cameras to compare: those given, else `AROUND` the default framing."""
    from ..viewpoints.default_framing import default_views
    from ..viewpoints.scene_views import SceneViews
    from ..viewpoints.seen_depths import seen_depths

    if cameras is None:
        views = default_views(gaussians)
        return views, [views.resolve(spec) for spec in AROUND]
    return SceneViews(cameras, *(seen_depths(gaussians, cameras) or (None, None))), cameras
