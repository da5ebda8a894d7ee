"""`gapmes reconstruct`: reconstruct Gaussians from a capture of posed photographs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..cameras.leave_one_out import DEFAULT_OTHERS
from ..leaving_out.budget import DEFAULT_CERTIFY
from ..mending.fade_passes import DEFAULT_PASSES
from ..network.backends.choice import DEFAULT_ENGINE, ENGINES, checked_engine
from ..options import checked_options
from ..process.streams import write_result
from ..process.terminal import ProgressBars, Quiet
from .given import Threads, output_option
from .summary import check_line, fading_line, left_out_lines, selection_line, warning_line


def reconstruct(
    capture: Annotated[
        Path,
        typer.Argument(
            metavar="CAPTURE",
            readable=False,
            help="folder, .zip or camera file with its photographs: cameras.json, transforms.json, COLMAP, LLFF,"
            " RealEstate10K",
        ),
    ],
    output: Annotated[Path, output_option("file to write: .ply, .compressed.ply, .splat or .spz", "-o", "--output")],
    views: Annotated[
        str | None,
        typer.Option(help="2 to 6 views by index or name, such as 1,5 [default: all; some of more than 6]"),
    ] = None,
    context: Annotated[
        int | None, typer.Option(help="number of views to choose, 2 to 6 [default: 3 if there are more than 6]")
    ] = None,
    near: Annotated[
        float | None, typer.Option(help="nearest depth, in the cameras' units; narrowed if it is far too near")
    ] = None,
    far: Annotated[float | None, typer.Option(help="farthest depth, in the cameras' units")] = None,
    trust_poses: Annotated[bool, typer.Option(help="only warn if photographs or overlap contradict the poses")] = False,
    refine_poses: Annotated[
        bool, typer.Option(help="correct poses that are slightly wrong, to match each other")
    ] = False,
    max_error: Annotated[
        str, typer.Option(help="largest change of a colour by leaving Gaussians out; 0: none, off: keep all")
    ] = "1/255",
    certify: Annotated[
        int, typer.Option(help="views between neighbouring inputs for which --max-error is proved")
    ] = DEFAULT_CERTIFY,
    min_opacity: Annotated[float, typer.Option(help="leave out fainter Gaussians, whatever that changes")] = 0.0,
    stride: Annotated[int, typer.Option(help="one Gaussian per so many pixels in each direction: 1, 2 or 4")] = 1,
    leave_one_out: Annotated[
        int, typer.Option(help="for three or more views: how many others predict each (2 to 5); 0: off")
    ] = DEFAULT_OTHERS,
    fade: Annotated[
        int,
        typer.Option(
            help="passes that fade and recolour what the photographs contradict; 0: none, nor are depths refined"
        ),
    ] = DEFAULT_PASSES,
    detail: Annotated[
        int, typer.Option(help="1, or 2 for four Gaussians per pixel, with the colours of the photographs' own pixels")
    ] = 1,
    model: Annotated[Path | None, typer.Option(readable=False, help="ONNX model [default: the packaged one]")] = None,
    engine: Annotated[str, typer.Option(help=f"engine that runs the network: {', '.join(ENGINES)}")] = DEFAULT_ENGINE,
    threads: Threads = None,
    as_json: Annotated[bool, typer.Option("--json", help="print the scene document to stdout as JSON")] = False,
    quiet: Quiet = False,
) -> None:
    """Reconstruct a scene from some of the views of a capture."""
    from ..captures.capture import open_capture
    from ..captures.select import ViewSelection, checked_selection
    from ..formats.encoded import Encoded
    from ..formats.ply import ply_bytes
    from ..formats.registry import format_of_path
    from ..from_capture import reconstruct_chosen
    from ..leaving_out.budget import Budget, parse_max_error
    from ..process.disk import named, replace_file
    from ..process.output_file import check_output_file
    from ..progress import Stages
    from ..reconstruct import Reconstructor
    from .kept_scene import kept_if_refused

    target = format_of_path(output, field="output")
    check_output_file(output, as_json=as_json)
    chosen = checked_engine(engine)
    options = checked_options(
        trust_poses=trust_poses,
        refine_poses=refine_poses,
        budget=Budget(parse_max_error(max_error), certify, min_opacity=min_opacity, stride=stride),
        leave_one_out=leave_one_out,
        fade=fade,
        detail=detail,
    )
    wanted = checked_selection(ViewSelection(views, context, field="views"))
    found = open_capture(capture).choose(wanted, near, far)
    near, far = found.checked_depths(near, far)
    with ProgressBars(quiet=quiet) as bars:
        stages = Stages(bars)
        with stages.stage("load model"):
            reconstructor = Reconstructor(model, threads=threads, engine=chosen)
        scene = reconstruct_chosen(reconstructor, found, near=near, far=far, listener=bars, **options._asdict())
        with stages.stage("write"), named(output):
            if target.extension == "ply":
                encoded = Encoded(ply_bytes(scene.gaussians, positions=scene.positions))
            else:
                with kept_if_refused(output, scene):
                    encoded = target.write(scene.gaussians)
            replace_file(output, encoded.data)
    bars.say(f"{len(scene.gaussians)} Gaussians in {output}")
    bars.say(selection_line(scene.document["selection"]))
    bars.say(check_line(scene.document["check"]))
    bars.say(fading_line(scene.document))
    for line in left_out_lines(scene.document):
        bars.say(line)
    for warning in scene.document["warnings"]:
        bars.say(warning_line(warning))
    for note in encoded.notes:
        bars.say(f"warning: {output.name}: {note}")
    if as_json:
        said = {
            "file": str(output),
            "format": target.extension,
            "notes": encoded.notes,
            "selected_views": list(found.indices),
        }
        write_result({**said, **scene.document})
