"""`gapmes render`: pictures of a .ply from the cameras of a file, by index or between two."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from ..effort import ALPHA_MIN, MAX_SAMPLES, STOP, Effort, draw
from ..terminal import ProgressBars
from .selection import view_specs

if TYPE_CHECKING:
    from ..camera import Camera
    from ..gaussians import Gaussians


def render(
    ply: Annotated[Path, typer.Argument(metavar="SCENE.PLY", help="the scene, in the 3DGS dialect")],
    cameras: Annotated[Path, typer.Option(help="cameras.json or transforms.json")],
    output: Annotated[Path, typer.Option("-o", "--output", help="folder for the pictures, made where it is missing")],
    views: Annotated[str | None, typer.Option(help="such as 5,6,7 or 5.5 between two [default: all]")] = None,
    size: Annotated[str | None, typer.Option(help="WIDTHxHEIGHT in px; another aspect is cropped to")] = None,
    crop: Annotated[Literal["none", "square"], typer.Option(help="square: the centred square of each view")] = "none",
    channel: Annotated[Literal["rgb", "alpha", "depth"], typer.Option(help="colour, opacity or z-depth")] = "rgb",
    background: Annotated[str, typer.Option(help="rrggbb in hex, black, white or grey")] = "black",
    alpha_min: Annotated[float, typer.Option(help="layers below this opacity are not drawn")] = ALPHA_MIN,
    stop: Annotated[float, typer.Option(help="what lies behind so little light is not drawn")] = STOP,
    sh_degree: Annotated[
        int | None, typer.Option(min=0, max=3, help="highest band of harmonics [default: all]")
    ] = None,
    samples: Annotated[int, typer.Option(min=1, max=MAX_SAMPLES, help="per side of a pixel")] = 1,
    drop_invalid: Annotated[
        bool,
        typer.Option("--drop-invalid", help="leave out and count Gaussians that cannot be read: NaN, beyond float32"),
    ] = False,
    threads: Annotated[int | None, typer.Option(min=1, max=1024, help="CPU threads [default: all]")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="print what was written to stdout as JSON")] = False,
) -> None:
    """Render views of a scene as PNG files named view_<view>.png.

    Where the camera file lacks near or far, the depths of the Gaussians that its cameras see stand in for them.
    """
    from ..captures.capture import read_camera_file
    from ..depth_range import depth_range
    from ..errors import PlyError
    from ..framing import frame, parse_size, square
    from ..picture import encode, parse_background
    from ..ply import inspect_ply
    from ..progress import Stages
    from ..scene_views import SceneViews
    from ..seen_depths import seen_depths

    effort = Effort(alpha_min, stop, sh_degree, samples)
    file = read_camera_file(cameras)
    specs = [str(index) for index in range(len(file.views))] if views is None else view_specs(views)
    in_file = file.near is not None and file.far is not None
    if in_file:
        depth_range(file.cameras, file.near, file.far)  # refuses what is no range
    scene = SceneViews(file.cameras, file.near, file.far) if in_file else SceneViews(file.cameras)
    for spec in specs:  # what is no view is said before the work
        scene.resolve(spec, field="views")
    sides = None if size is None else parse_size(size)
    options = {"background": parse_background(background), "threads": threads}
    if not ply.is_file():
        raise PlyError(f"{ply} is not a file", field="SCENE.PLY")
    written = []
    with ProgressBars() as bars:
        stages = Stages(bars)
        with stages.stage("read .ply"):
            reading = inspect_ply(ply, drop_invalid=drop_invalid)
            gaussians = reading.gaussians
        if not in_file:
            scene = SceneViews(file.cameras, *(seen_depths(gaussians, file.cameras) or (None, None)))
        shots = [scene.resolve(spec, field="views") for spec in specs]
        if crop == "square":
            shots = [square(camera) for camera in shots]
        if sides is not None:
            shots = [frame(camera, *sides) for camera in shots]
        output.mkdir(parents=True, exist_ok=True)
        with stages.stage("render", len(shots)) as step:
            for spec, camera in zip(specs, shots, strict=True):
                drawn = draw(gaussians, camera, channel, effort, **options, **scene.near_plane)
                picture = encode(drawn, channel)
                path = output / f"view_{spec.replace(':', '_')}.png"
                path.write_bytes(picture.data)
                entry = {"view": spec, "file": str(path), "width": camera.width, "height": camera.height}
                if picture.depth_range is not None:
                    entry["depth_range"] = picture.depth_range
                written.append(entry)
                step(len(written))
    warnings = [*reading.notes(), *_precision(gaussians, shots, scene.near)]
    bars.say(f"{len(written)} pictures in {output}")
    for warning in warnings:
        bars.say(f"warning: {warning}")
    if as_json:
        document = {"gaussians": len(gaussians), "views": written, "warnings": warnings, "timings": stages.timings}
        sys.stdout.write(json.dumps(document, allow_nan=False) + "\n")


def _precision(gaussians: Gaussians, shots: Sequence[Camera], near: float | None) -> list[str]:
    """A sentence where positions are float32 numbers so far from the origin that it shows."""
    from ..float32 import half_step, largest_shift
    from ..pose_notices import TOLD_PX

    focal = max(max(camera.fx, camera.fy) for camera in shots)
    shift = 0.0 if near is None else largest_shift(half_step(gaussians.means), focal, near)
    if shift <= TOLD_PX:
        return []
    return [
        f"positions are float32 numbers far from the origin: if they were rounded to it, the precision of the input is "
        f"{shift:.2g} px at z-depth {near:.4g}"
    ]
