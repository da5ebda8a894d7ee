"""`gapmes reconstruct`: a folder of posed photographs into a .ply."""

from __future__ import annotations

import json
import sys
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from ..backends.choice import DEFAULT_ENGINE, ENGINES, checked_engine
from ..budget import DEFAULT_CERTIFY
from ..foretold import DEFAULT_OTHERS, checked_others
from ..terminal import ProgressBars, Quiet
from .selection import view_indices
from .summary import check_line, left_out_lines


def reconstruct(
    scene_dir: Annotated[
        Path, typer.Argument(metavar="SCENE_DIR", help="folder with cameras.json or transforms.json and its images")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help=".ply to write")],
    views: Annotated[str | None, typer.Option(help="2 to 6 view indices such as 4,8 [default: all]")] = None,
    near: Annotated[float | None, typer.Option(help="nearest depth, in the cameras' units")] = None,
    far: Annotated[float | None, typer.Option(help="farthest depth, in the cameras' units")] = None,
    trust_poses: Annotated[bool, typer.Option(help="only warn where photographs or overlap oppose the poses")] = False,
    max_error: Annotated[
        str, typer.Option(help="change of colour up to which Gaussians are left out; 0: none, off: keep all")
    ] = "1/255",
    certify: Annotated[
        int, typer.Option(help="views between neighbouring inputs for which that is proved")
    ] = DEFAULT_CERTIFY,
    min_opacity: Annotated[float, typer.Option(help="fainter Gaussians are left out, whatever that changes")] = 0.0,
    stride: Annotated[int, typer.Option(help="a Gaussian per so many pixels each way: 1, 2 or 4")] = 1,
    leave_one_out: Annotated[
        int, typer.Option(help="of three views or more, how many others foretell each (2 to 5); 0: not done")
    ] = DEFAULT_OTHERS,
    model: Annotated[Path | None, typer.Option(help="ONNX model [default: the packaged one]")] = None,
    engine: Annotated[
        str, typer.Option(help=f"what computes the network: {', '.join(ENGINES)} [default: onnxruntime]")
    ] = DEFAULT_ENGINE,
    threads: Annotated[int | None, typer.Option(min=1, max=1024, help="CPU threads [default: all]")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="print the scene document to stdout as JSON")] = False,
    quiet: Quiet = False,
) -> None:
    """Reconstruct a scene from some of the views of a folder."""
    from ..budget import Budget, parse_max_error
    from ..camera_file import load_scene_folder
    from ..errors import InputError
    from ..images import decode_image
    from ..ply import write_ply
    from ..progress import Stages
    from ..reconstruct import Reconstructor
    from ..splat import warm_up

    if not output.parent.is_dir():  # said before the work, not after it
        raise InputError(f"{output.parent} is not a folder", field="output")
    checked_others(leave_one_out)
    chosen = checked_engine(engine)
    budget = Budget(parse_max_error(max_error), certify, min_opacity=min_opacity, stride=stride)
    folder = load_scene_folder(scene_dir, None if views is None else partial(view_indices, views))
    with ProgressBars(quiet=quiet) as bars:
        stages = Stages(bars)
        with stages.stage("load model"):
            reconstructor = Reconstructor(model, threads=threads, engine=chosen)
        with stages.stage("kernels"):  # compiled the first time, then loaded
            warm_up()
        with stages.stage("read images", len(folder.indices)) as step:
            photos = []
            for index, path in zip(folder.indices, folder.image_paths, strict=True):
                photos.append(decode_image(path.read_bytes(), index=index))
                step(len(photos))
        scene = reconstructor.reconstruct(
            photos,
            folder.file.cameras,
            near=folder.file.near if near is None else near,
            far=folder.file.far if far is None else far,
            trust_poses=trust_poses,
            budget=budget,
            leave_one_out=leave_one_out,
            listener=bars,
        )
        with stages.stage("write .ply"):
            write_ply(output, scene.gaussians)
    bars.say(f"{len(scene.gaussians)} Gaussians in {output}")
    bars.say(check_line(scene.document["check"]))
    for line in left_out_lines(scene.document):
        bars.say(line)
    for warning in scene.document.get("warnings", ()):
        bars.say(f"warning: {warning['message']}")
    if as_json:
        document = {"ply": str(output), "selected_views": list(folder.indices), **scene.document}
        sys.stdout.write(json.dumps(document, allow_nan=False) + "\n")
