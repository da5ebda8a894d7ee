"""Measure what leaving Gaussians out saves and changes on photographs: the whole scene against the reduced one.

`python -m benchmarks.scene.leaving_out SCENE_DIR... [--inputs 2] [--fade 4] [--rounds 5]` takes folders whose
cameras.json suggests inputs and held-out targets. Each row has the .ply and the time of a picture of 512 px as shares
of the whole scene's, the bound and the largest change found in 1/255, the change of PSNR on the targets, and the time
of deciding as a share of the reconstruction. Times are medians over the rounds after a first one that is not counted;
pictures of both scenes are drawn in turns.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gapmes.export.evaluation.case import photograph_case
from gapmes.service.formats.ply_write import ply_size
from gapmes.service.leaving_out.budget import KEEP_ALL
from gapmes.service.mending.fade_passes import DEFAULT_PASSES
from gapmes.service.photographs.images import FittedView
from gapmes.service.pictures.picture_error import psnr
from gapmes.service.reconstruct import Reconstructor, Scene
from gapmes.service.viewpoints.framing import frame

from ..options import at_least_one, passes, refusals_told, there

SIDE = 256  # px of inputs and targets
PICTURE = 512  # px of the picture that is timed

HEADER = """| scene | inputs | .ply | time of a picture | bound | found | PSNR, dB | deciding |
|---|---|---|---|---|---|---|---|
"""


def held_out_psnr(scene: Scene, targets: Sequence[FittedView]) -> float:
    """Mean over the targets, colours clipped to [0, 1]."""
    pictures = [scene.render(view.camera).rgb.transpose(2, 0, 1).clip(0, 1) for view in targets]
    return float(np.mean([psnr(drawn, view.image) for drawn, view in zip(pictures, targets, strict=True)]))


def picture_times(scenes: Sequence[Scene], rounds: int) -> list[float]:
    """Median seconds of the first input's picture at `PICTURE` px, of each scene in turn."""
    found: list[list[float]] = [[] for _ in scenes]
    for number in range(rounds + 1):
        for scene, seconds in zip(scenes, found, strict=True):
            camera = frame(scene.view_cameras[0], width=PICTURE)
            start = time.perf_counter()
            scene.render(camera)
            if number:
                seconds.append(time.perf_counter() - start)
    return [statistics.median(seconds) for seconds in found]


def row(service: Reconstructor, folder: Path, inputs: int, fade: int, rounds: int) -> str:
    """One row of the table; deciding is timed in `rounds` reconstructions after one that is not counted."""
    case = photograph_case(folder, inputs, SIDE, SIDE)
    whole = case.reconstructed(service, budget=KEEP_ALL, fade=fade)
    runs = [case.reconstructed(service, fade=fade) for _ in range(rounds + 1)]
    lean = runs[0]
    timings = [run.document["timings"] for run in runs[1:]]
    deciding = statistics.median(times["leave out"] / sum(times.values()) for times in timings)
    share = ply_size(lean.gaussians) / ply_size(whole.gaussians)
    whole_time, lean_time = picture_times([whole, lean], rounds)
    change = held_out_psnr(lean, case.targets) - held_out_psnr(whole, case.targets)
    left_out = lean.document["pruning"]
    cells = [
        folder.name,
        str(inputs),
        f"{share:.3f}",
        f"{lean_time / whole_time:.2f}",
        f"{left_out['bound'] * 255:.2f}",
        f"{left_out['actual'] * 255:.2f}",
        f"{round(change, 4) + 0.0:.4f}",  # -0 is 0
        f"{deciding:.1%}",
    ]
    return f"| {' | '.join(cells)} |\n"


@refusals_told()
def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="+", type=there, metavar="SCENE_DIR")
    parser.add_argument("--inputs", type=int, choices=(2, 3), action="append", help="repeat for both [default: 2]")
    parser.add_argument("--fade", type=passes, default=DEFAULT_PASSES)
    parser.add_argument("--rounds", type=at_least_one, default=5)
    options = parser.parse_args()
    service = Reconstructor()
    sys.stdout.write(HEADER)
    for inputs in options.inputs or [2]:
        for folder in options.scenes:
            sys.stderr.write(f"{folder.name} from {inputs}\n")
            sys.stdout.write(row(service, folder, inputs, options.fade, options.rounds))
            sys.stdout.flush()


if __name__ == "__main__":
    main()
