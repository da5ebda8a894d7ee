"""Measure the cost of each format of Gaussians: bytes, and pictures of the file against those of the original scene.

`python -m benchmarks.scene.formats [SCENE_DIR...] [--fade 4]` reconstructs each scene from the two views that the
service chooses, writes it in every format, reads it again and draws it from all cameras of its folder, reduced to sides
of 256 px or less. Without SCENE_DIR it takes the sample scene. It prints a table for each scene, and one for all of
several.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gapmes.service.captures.capture import open_capture
from gapmes.service.captures.select import ViewSelection
from gapmes.service.formats.cost import picture_psnr
from gapmes.service.formats.dialect import AUTO
from gapmes.service.formats.registry import FORMATS
from gapmes.service.mending.fade_passes import DEFAULT_PASSES
from gapmes.service.photographs.images import EncodedPhoto
from gapmes.service.pictures.picture_error import EQUAL_DB
from gapmes.service.reconstruct import Reconstructor
from gapmes.service.shipped import sample_folder
from gapmes.service.viewpoints.framing import within
from gapmes.service.viewpoints.scene_views import SceneViews

from ..options import passes, refusals_told, there

SIDE = 256  # px, the longest of a picture

HEADER = """| format | bytes | share | PSNR, dB: lowest, mean |
|---|---|---|---|
"""


@dataclass(frozen=True)
class Cost:
    """The cost of one format for one scene, or for several together."""

    size: int  # bytes
    psnr: list[float]  # dB, one per picture


def costs(service: Reconstructor, folder: Path, fade: int) -> dict[str, Cost]:
    """The cost of each format, by its extension."""
    capture = open_capture(folder)
    found = capture.choose(ViewSelection(context=2))
    photos = [EncodedPhoto(found.read(place), lens=view.lens) for place, view in enumerate(found.file.views)]
    scene = service.reconstruct(
        photos, found.file.cameras, near=found.file.near, far=found.file.far, fade=fade, leave_one_out=0, whole=False
    )
    cameras = [within(camera, SIDE) for camera in capture.cameras(range(len(capture.names))).cameras]
    near_plane = SceneViews.of_document(scene.document).near_plane
    result = {}
    for name, entry in FORMATS.items():
        data = entry.write(scene.gaussians).data
        kept = entry.read(data, AUTO, False, None).gaussians
        values = picture_psnr(scene.gaussians, kept, cameras, near_plane)
        result[name] = Cost(len(data), [value for value in values if value is not None])  # of cameras that see it
    return result


def table(title: str, found: dict[str, Cost]) -> str:
    """A Markdown table with a row for each format."""
    lines = [f"\n{title}\n\n", HEADER]
    for name, cost in found.items():
        shown = "equal" if min(cost.psnr) == EQUAL_DB else f"{min(cost.psnr):.1f}, {np.mean(cost.psnr):.1f}"
        lines.append(f"| `{name}` | {cost.size:,} | {cost.size / found['ply'].size:.0%} | {shown} |\n")
    return "".join(lines)


@refusals_told()
def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", type=there, default=[sample_folder()], metavar="SCENE_DIR")
    parser.add_argument("--fade", type=passes, default=DEFAULT_PASSES)
    options = parser.parse_args()
    service = Reconstructor()
    by_format: dict[str, list[Cost]] = defaultdict(list)
    for folder in options.scenes:
        sys.stderr.write(f"{folder.name}\n")
        found = costs(service, folder, options.fade)
        sys.stdout.write(table(folder.name, found))
        sys.stdout.flush()
        for name, cost in found.items():
            by_format[name].append(cost)
    if len(options.scenes) > 1:
        whole = {
            name: Cost(sum(c.size for c in each), [x for c in each for x in c.psnr]) for name, each in by_format.items()
        }
        sys.stdout.write(table("all", whole))


if __name__ == "__main__":
    main()
