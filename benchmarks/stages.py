"""Measure processor seconds of every stage from encoded photographs to a written .ply, with mending and without.

`python -m benchmarks.stages [CAPTURE] [--views 1,5] [--engine NAME] [--rounds 5]` runs on one thread, in one process.
Both settings take turns in every round. Figures are medians over the rounds after a first one that is not counted.
Loading the model and the kernels is not included.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path

from gapmes.service.captures.capture import open_capture
from gapmes.service.captures.select import ViewSelection, checked_selection
from gapmes.service.formats.ply_write import write_ply
from gapmes.service.mending.fade_passes import DEFAULT_PASSES
from gapmes.service.network.backends.choice import DEFAULT_ENGINE, ENGINES
from gapmes.service.photographs.images import EncodedPhoto
from gapmes.service.progress import Stage
from gapmes.service.reconstruct import Reconstructor
from gapmes.service.shipped import sample_folder

from .options import at_least_one, refusals_told, there


class Clock:
    """Listens to the stages and sums the processor time of each."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._since = 0.0

    def __call__(self, event: Stage) -> None:
        now = time.process_time()
        if event.seconds is not None:
            self.seconds[event.name] += now - self._since
        elif event.done == 0:
            self._since = now


def one_run(service: Reconstructor, capture: Path, views: str, passes: int) -> dict[str, float]:
    """Seconds by stage; `write .ply` is the time of writing the file, `all` that of everything, opening included."""
    start, clock = time.process_time(), Clock()
    found = open_capture(capture).choose(checked_selection(ViewSelection(views, None, field="views")))
    read = [found.read(place) for place in range(len(found.indices))]
    photos = [EncodedPhoto(data, lens=view.lens) for data, view in zip(read, found.file.views, strict=True)]
    scene = service.reconstruct(
        photos, found.file.cameras, near=found.file.near, far=found.file.far, fade=passes, listener=clock
    )
    before = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        write_ply(Path(folder) / "scene.ply", scene.gaussians)
    end = time.process_time()
    return {**clock.seconds, "write .ply": end - before, "all": end - start}


@refusals_told()
def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("capture", nargs="?", type=there, default=sample_folder())
    parser.add_argument("--views", default="1,5")
    parser.add_argument("--engine", choices=ENGINES, default=DEFAULT_ENGINE)
    parser.add_argument("--rounds", type=at_least_one, default=5)
    options = parser.parse_args()
    service = Reconstructor(threads=1, engine=options.engine)
    settings = (DEFAULT_PASSES, 0)
    found: dict[int, list[dict[str, float]]] = {passes: [] for passes in settings}
    for number in range(options.rounds + 1):
        sys.stderr.write(f"round {number} of {options.rounds}\n")
        for passes in settings:
            seconds = one_run(service, options.capture, options.views, passes)
            if number:
                found[passes].append(seconds)
    sys.stdout.write("| stage |" + "".join(f" --fade {passes} |" for passes in settings) + "\n|---|---|---|\n")
    for name in found[settings[0]][0]:
        cells = [[run[name] for run in found[passes] if name in run] for passes in settings]
        shown = [f"{statistics.median(values):.2f}" if values else "" for values in cells]
        sys.stdout.write(f"| {name} | {' | '.join(shown)} |\n")


if __name__ == "__main__":
    main()
