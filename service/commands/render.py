"""`gapmes render`: pictures, a film or a contact sheet of a file of Gaussians, from the cameras of a file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ..pictures.effort import ALPHA_MIN, MAX_SAMPLES, STOP, Effort
from ..plain_number import counted
from ..process.streams import write_result
from ..process.terminal import ProgressBars, Quiet
from ..viewpoints.camera_path import PathName
from .dialect_options import (
    AxesOption,
    DropInvalidOption,
    OpacityOption,
    RotationOption,
    ScalesOption,
    SourceFormatOption,
)
from .given import Threads, output_option
from .selection import view_specs

if TYPE_CHECKING:
    from ..cameras.camera import Camera
    from ..formats.reading import Reading
    from ..gaussians import Gaussians


def render(
    ply: Annotated[Path, typer.Argument(metavar="SCENE", readable=False, help=".ply, .compressed.ply, .splat or .spz")],
    output: Annotated[
        Path,
        output_option("folder for pictures, created if missing, or the file of a film or sheet", "-o", "--output"),
    ],
    cameras: Annotated[
        Path | None,
        typer.Option(
            readable=False,
            help="a camera file, or the folder or .zip of a capture [default: one camera in front of the scene]",
        ),
    ] = None,
    views: Annotated[str | None, typer.Option(help="such as 5,6,7, or 5.5 between two [default: all]")] = None,
    size: Annotated[str | None, typer.Option(help="WIDTHxHEIGHT in px; views are cropped to this aspect ratio")] = None,
    crop: Annotated[Literal["none", "square"], typer.Option(help="square: the centred square of each view")] = "none",
    path: Annotated[
        PathName | None,
        typer.Option(help="path of a film: about the scene, through the views and back, or all around it"),
    ] = None,
    seconds: Annotated[float | None, typer.Option(min=0.1, max=600, help="length of a film [default: 4]")] = None,
    fps: Annotated[float | None, typer.Option(min=1, max=50, help="frames per second of a film [default: 24]")] = None,
    swing: Annotated[
        float | None, typer.Option(help="degrees to each side of a turntable [default: as far as the views reach]")
    ] = None,
    sheet: Annotated[bool, typer.Option("--sheet", help="all views in one picture, .png, .jpg or .webp")] = False,
    channel: Annotated[Literal["rgb", "alpha", "depth"], typer.Option(help="colour, opacity or z-depth")] = "rgb",
    depth_scale: Annotated[
        float | None,
        typer.Option(help="units of depth per grey level, such as 0.001 [default: chosen for the picture's depths]"),
    ] = None,
    background: Annotated[str, typer.Option(help="rrggbb in hex, black, white or grey")] = "black",
    alpha_min: Annotated[float, typer.Option(help="do not draw layers below this opacity")] = ALPHA_MIN,
    stop: Annotated[float, typer.Option(help="stop at a pixel once its transmittance falls to this")] = STOP,
    cut_radius: Annotated[
        float | None,
        typer.Option(help="do not draw a Gaussian beyond so many standard deviations [default: no limit]"),
    ] = None,
    sh_degree: Annotated[
        int | None, typer.Option(min=0, max=3, help="highest band of harmonics [default: all]")
    ] = None,
    samples: Annotated[int, typer.Option(min=1, max=MAX_SAMPLES, help="samples per side of a pixel")] = 1,
    source_format: SourceFormatOption = None,
    opacity: OpacityOption = "auto",
    scales: ScalesOption = "auto",
    rotation: RotationOption = "auto",
    axes: AxesOption = "rub",
    drop_invalid: DropInvalidOption = False,
    threads: Threads = None,
    as_json: Annotated[bool, typer.Option("--json", help="print what was written to stdout as JSON")] = False,
    quiet: Quiet = False,
) -> None:
    """Render views of a scene as PNG files such as view_5.png, or a film where OUTPUT ends in .mp4, .webp or .gif.

    Where the camera file lacks near and far, the depths of the Gaussians that its cameras see stand in for them.
    Without a camera file one camera, which looks along +z, frames most of the scene.
    """
    from ..formats.dialect import Dialect
    from ..formats.registry import inspect_gaussians
    from ..pictures.picture import check_format, parse_background
    from ..process.output_file import check_output_file
    from ..progress import Stages
    from ..viewpoints.default_framing import default_views
    from ..viewpoints.framing import frame, parse_size, square
    from ..viewpoints.scene_views import SceneViews
    from ..viewpoints.seen_depths import seen_depths
    from .asked_cameras import views_of_file
    from .input_file import check_input_file
    from .outputs import (
        Drawing,
        FilmPlan,
        check_folder,
        check_sheet,
        empty_pictures,
        write_moving,
        write_pictures,
        write_sheet,
    )

    effort = Effort(alpha_min, stop, sh_degree, samples, cut_radius)
    sides = None if size is None else parse_size(size)
    moving: dict[str, Any] = {"path": path, "seconds": seconds, "fps": fps, "swing": swing}
    plan = FilmPlan.asked(output, channel, sheet, sides is not None, **moving)
    asked = None if views is None else view_specs(views, repeated=path == "inputs")  # which may pass a view twice
    options = {"background": parse_background(background), "threads": threads}
    dialect = Dialect(opacity, scales, rotation, axes)
    with ProgressBars(quiet=quiet) as bars:
        stages = Stages(bars)

        def read() -> Reading:
            if sheet or plan is not None:
                check_output_file(output, as_json=as_json)
            else:
                check_folder(output)
            check_input_file(ply, "SCENE", source_format)
            with stages.stage("read"):
                return inspect_gaussians(ply, format=source_format, dialect=dialect, drop_invalid=drop_invalid)[0]

        reading, passed_over = None, list[str]()
        if cameras is None:
            reading = read()
            scene = default_views(reading.gaussians)
        else:
            scene, passed_over = views_of_file(cameras, asked if plan is None else None)  # a film is about all
        specs = [str(index) for index in range(len(scene.cameras))] if asked is None else asked

        def fit(camera: Camera) -> Camera:
            cropped = square(camera) if crop == "square" else camera
            return cropped if sides is None else frame(cropped, *sides)

        shots = [fit(scene.resolve(spec, field="views")) for spec in specs]
        for shot in shots:  # with cameras, checked before the Gaussians are read
            check_format(shot.width, shot.height, channel, "png", depth_scale)
        if plan is not None:
            plan.among(scene, specs)
            passed_over += plan.notes(plan.shape(plan.fit(shots[0])))
        if sheet:
            check_sheet(output, channel, shots)
        reading = reading or read()
        gaussians = reading.gaussians
        if scene.near is None:
            scene = SceneViews(scene.cameras, *(seen_depths(gaussians, scene.cameras) or (None, None)))
        drawing = Drawing(gaussians, scene, specs, fit, channel, effort, options)
        written: dict[str, Any]
        if plan is not None:
            written = {"film": write_moving(drawing, output, plan, stages)}
        elif sheet:
            written = {"sheet": write_sheet(drawing, output, stages)}
        else:
            written = {"views": write_pictures(drawing, output, depth_scale, stages)}
    precision = _precision(gaussians, drawing.shots, scene.near)
    warnings = [*passed_over, *reading.notes(), *precision, *empty_pictures(drawing)]
    bars.say(f"{counted(len(written['views']), 'picture')} in {output}" if "views" in written else f"wrote {output}")
    for warning in warnings:
        bars.say(f"warning: {warning}")
    if as_json:
        document = {"gaussians": len(gaussians), **written, "warnings": warnings, "timings": stages.timings}
        write_result(document)


def _precision(gaussians: Gaussians, shots: Sequence[Camera], near: float | None) -> list[str]:
    """A warning if positions are so far from the origin that float32 rounding would be visible."""
    from ..cameras.float32 import half_step, largest_shift
    from ..cameras.pose_notices import LEAST_SHIFT_PX

    focal = max(max(camera.fx, camera.fy) for camera in shots)
    shift = 0.0 if near is None else largest_shift(half_step(gaussians.means), focal, near)
    if shift <= LEAST_SHIFT_PX:
        return []
    return [
        f"positions are float32 numbers far from the origin: if they were rounded to it, the precision of the input is "
        f"{shift:.2g} px at z-depth {near:.4g}"
    ]
