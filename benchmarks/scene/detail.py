"""Compare `detail` 2 with `detail` 1: pictures of twice the network's size against held-out photographs, and the cost.

`python -m benchmarks.scene.detail [SCENE_DIR...] [--generated N] [--inputs 2] [--fade 4] [--pictures DIR]` takes
folders whose cameras.json suggests inputs and targets, and N generated scenes whose pictures have twice the network's
size. Both scenes are drawn from the targets' cameras at twice the network's size, and scenes of photographs also at its
own; the photographs are resized to that. LPIPS needs its weights. The pictures show the middle of each scene's first
target: the truth, `detail` 1, `detail` 2.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gapmes.export.evaluation.case import Case, generated_cases, photograph_case
from gapmes.export.evaluation.metrics import Figures, figures, mean_figures
from gapmes.model.training.lpips import Lpips, default_weights
from gapmes.service.formats.ply_write import ply_size
from gapmes.service.mending.detail_level import DETAILS
from gapmes.service.mending.fade_passes import DEFAULT_PASSES
from gapmes.service.photographs.images import FittedView
from gapmes.service.reconstruct import Reconstructor, Scene

from ..options import none_or_more, passes, refusals_told, there, view_count

Targets = Sequence[FittedView]
Found = tuple[Case, Targets, Targets]

HEADER = """| scene, detail | PSNR / SSIM / LPIPS at {twice} px | at {once} px | Gaussians | .ply, MB | CPU, s |
|---|---|---|---|---|---|
"""


@dataclass(frozen=True)
class Row:
    """One scene with one detail, or the mean of several."""

    twice: Figures
    once: Figures
    count: float
    size: float  # bytes
    seconds: float  # of processor time, all threads

    def line(self, title: str) -> str:
        """The row in Markdown."""
        return (
            f"| {title} | {_shown(self.twice)} | {_shown(self.once)} | {self.count:,.0f} | {self.size / 1e6:.1f} | "
            f"{self.seconds:.1f} |\n"
        )


def compared(scene: Scene, targets: Targets, lpips: Lpips | None) -> Figures:
    """Mean over the targets, over all pixels of each."""
    each = []
    for target in targets:
        picture = drawn(scene, target)
        each.append(figures(picture, target.image, np.ones(picture.shape[1:], np.bool_), lpips))
    return mean_figures(each)


def drawn(scene: Scene, target: FittedView) -> NDArray[np.float32]:
    """(3, H, W) in [0, 1] from the target's camera."""
    return np.clip(scene.render(target.camera).rgb, 0, 1).transpose(2, 0, 1).astype(np.float32)


def save_middles(path: Path, pictures: Sequence[NDArray[np.float32]]) -> None:
    """The middle halves (in both directions) of pictures (3, H, W), side by side, enlarged twice without smoothing."""
    middles = []
    for picture in pictures:
        height, width = (side // 4 for side in picture.shape[1:])
        middle = picture[:, height : 3 * height, width : 3 * width].transpose(1, 2, 0)
        middles.append(np.rint(255 * middle).astype(np.uint8).repeat(2, axis=0).repeat(2, axis=1))
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.concatenate(middles, axis=1)).save(path)


def photographs(folders: Sequence[Path], inputs: int, height: int, width: int) -> Iterator[Found]:
    """Scenes with their targets at twice the network's size and at its own."""
    for folder in folders:
        case = photograph_case(folder, inputs, height, width)
        assert case.at_twice is not None
        yield case, case.at_twice().views, case.targets


def generated(count: int, inputs: int, height: int, width: int) -> Iterator[Found]:
    """The same of generated scenes, which have targets at twice the size alone."""
    for case in generated_cases(count, inputs, 2 * height, 2 * width):
        yield case, case.targets, ()


def row(service: Reconstructor, found: Found, detail: int, fade: int, lpips: Lpips | None) -> tuple[Row, Scene]:
    """Reconstruct and compare."""
    case, *sizes = found
    started = time.process_time()
    scene = case.reconstructed(service, detail=detail, fade=fade)
    seconds = time.process_time() - started
    twice, once = (compared(scene, targets, lpips) for targets in sizes)
    return Row(twice, once, len(scene.gaussians), ply_size(scene.gaussians), seconds), scene


def mean(rows: Sequence[Row]) -> Row:
    twice, once = (mean_figures([getattr(each, name) for each in rows]) for name in ("twice", "once"))
    count, size, seconds = (
        float(np.mean([getattr(each, name) for each in rows])) for name in ("count", "size", "seconds")
    )
    return Row(twice, once, count, size, seconds)


def _shown(found: Figures) -> str:
    values = zip((found.psnr, found.ssim, found.lpips), (2, 3, 3), strict=True)
    return " / ".join("-" if value is None else f"{value:.{digits}f}" for value, digits in values)


@refusals_told()
def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", type=there, metavar="SCENE_DIR")
    parser.add_argument("--generated", type=none_or_more, default=0)
    parser.add_argument("--inputs", type=view_count, default=2)
    parser.add_argument("--fade", type=passes, default=DEFAULT_PASSES)
    parser.add_argument("--pictures", type=Path, metavar="DIR")
    options = parser.parse_args()
    if not options.scenes and options.generated < 1:
        parser.error("no scenes: name a SCENE_DIR, or give --generated 8")
    weights = default_weights()
    lpips = None if weights is None else Lpips.load(weights)
    service = Reconstructor()
    height, width = service.engine.info.height, service.engine.info.width
    sys.stdout.write(HEADER.format(once=f"{height}x{width}", twice=f"{2 * height}x{2 * width}"))
    size = options.inputs, height, width
    for kind, scenes in (
        ("photographs", photographs(options.scenes, *size)),
        ("generated scenes", generated(options.generated, *size)),
    ):
        rows: dict[int, list[Row]] = {detail: [] for detail in DETAILS}
        for found in scenes:
            name, target = found[0].name, found[1][0]
            shown = [target.image]
            for detail, each in rows.items():
                figured, scene = row(service, found, detail, options.fade, lpips)
                each.append(figured)
                shown.append(drawn(scene, target))
                sys.stdout.write(figured.line(f"{name}, {detail}"))
                sys.stdout.flush()
            if options.pictures is not None:
                save_middles(options.pictures / f"{name.replace(' ', '_')}.png", shown)
        for detail, each in rows.items():
            if len(each) > 1:
                sys.stdout.write(mean(each).line(f"mean of {len(each)} {kind}, {detail}"))


if __name__ == "__main__":
    main()
