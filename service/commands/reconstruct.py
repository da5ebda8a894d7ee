"""`gapmes reconstruct`: a folder of posed photographs into a .ply."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from ..terminal import ProgressBars
from .selection import view_indices


def reconstruct(
    scene_dir: Annotated[
        Path, typer.Argument(metavar="SCENE_DIR", help="folder with cameras.json or transforms.json and its images")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help=".ply to write")],
    views: Annotated[str | None, typer.Option(help="2 to 6 view indices such as 4,8 [default: all]")] = None,
    near: Annotated[float | None, typer.Option(help="nearest depth, in the cameras' units")] = None,
    far: Annotated[float | None, typer.Option(help="farthest depth, in the cameras' units")] = None,
    trust_poses: Annotated[bool, typer.Option(help="only warn where photographs or overlap oppose the poses")] = False,
    model: Annotated[Path | None, typer.Option(help="ONNX model [default: the packaged one]")] = None,
    threads: Annotated[int | None, typer.Option(min=1, max=1024, help="CPU threads [default: all]")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="print the scene document to stdout as JSON")] = False,
) -> None:
    """Reconstruct a scene from some of the views of a folder."""
    from ..camera_file import load_scene_folder
    from ..errors import InputError
    from ..images import decode_image
    from ..ply import write_ply
    from ..progress import Stages
    from ..reconstruct import Reconstructor
    from ..splat import warm_up

    if not output.parent.is_dir():  # said before the work, not after it
        raise InputError(f"{output.parent} is not a folder", field="output")
    folder = load_scene_folder(scene_dir, None if views is None else partial(view_indices, views))
    with ProgressBars() as bars:
        stages = Stages(bars)
        with stages.stage("load model"):
            reconstructor = Reconstructor(model, threads=threads)
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
            listener=bars,
        )
        with stages.stage("write .ply"):
            write_ply(output, scene.gaussians)
    bars.say(f"{len(scene.gaussians)} Gaussians in {output}")
    bars.say(check_line(scene.document["check"]))
    for warning in scene.document.get("warnings", ()):
        bars.say(f"warning: {warning['message']}")
    if as_json:
        document = {"ply": str(output), "selected_views": list(folder.indices), **scene.document}
        sys.stdout.write(json.dumps(document, allow_nan=False) + "\n")


def check_line(check: Mapping[str, Any]) -> str:
    """The self-check in a line: what the scene shows of its own inputs, and how much of them says nothing of depth."""
    shown = ", ".join("no pixel" if row["psnr"] is None else f"{row['psnr']:.1f}" for row in check["input_views"])
    parts = [f"inputs drawn again: {shown} dB"]
    for name, share in (("textureless", "textureless_share"), ("without parallax", "no_parallax_share")):
        if check[share] is not None:
            parts.append(f"{100 * check[share]:.1f} % {name}")
    if check["depth_step"]["middle"] is not None:
        parts.append(f"depth candidates every {200 * check['depth_step']['middle']:.1f} % half way")
    return "; ".join(parts)
