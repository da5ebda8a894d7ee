"""Score the shipped road on photographs: reconstruct from a scene's suggested views, compare at its suggested targets.

`python -m gapmes.export.score SCENE_DIR... [--inputs 2] [--out DIR]` prints PSNR and SSIM per scene beside those of the
nearest input shown as it is, and leaves a picture per scene: inputs, then truth over render for each target.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from rich.console import Console
from rich.table import Table

from gapmes.model.training.losses import gaussian_ssim, psnr
from gapmes.service.camera import Camera
from gapmes.service.camera_file import load_scene_folder
from gapmes.service.images import FittedView, Photo, decode_image, fit_view, match_photo
from gapmes.service.reconstruct import Reconstructor
from gapmes.service.splat import render

F32 = NDArray[np.float32]
NEAR_SHARE = 0.05  # of the scene's near depth: nothing that the network places lies closer


@dataclass(frozen=True)
class Score:
    """Means over a scene's targets; `copy_*` is the nearest input shown unchanged."""

    scene: str
    inputs: list[int]
    targets: list[int]
    psnr: float
    ssim: float
    copy_psnr: float
    copy_ssim: float
    holes: float  # share of pixels with alpha below 0.5
    seconds: float


@dataclass(frozen=True)
class Drawn:
    """Images (n, 3, H, W) in [0, 1] of one scored scene."""

    inputs: F32
    truth: F32
    rendered: F32


def score_scene(folder: Path, reconstructor: Reconstructor, inputs: int) -> tuple[Score, Drawn]:
    """Centre-crop everything to the network's size; the targets are never seen by the reconstruction."""
    suggested = json.loads((folder / "cameras.json").read_text())["suggested"]
    context, targets = suggested[f"context{inputs}"], suggested[f"target{inputs}"]
    scene = load_scene_folder(folder)
    height, width = reconstructor.engine.info.height, reconstructor.engine.info.width

    def load(index: int) -> tuple[Photo, Camera]:
        photo = decode_image(scene.image_paths[index].read_bytes(), index=index)
        return match_photo(photo, scene.file.views[index].camera, index=index)

    def fitted(index: int) -> FittedView:
        return fit_view(*load(index), height, width)

    given = [load(index) for index in context]
    result = reconstructor.reconstruct(
        [photo for photo, _ in given], [camera for _, camera in given], near=scene.file.near, far=scene.file.far
    )
    near = NEAR_SHARE * result.document["near"]
    rendered, copies, alphas, truth = [], [], [], []
    seen = [fitted(index) for index in context]
    for index in targets:
        target = fitted(index)
        picture = render(result.gaussians, target.camera, near=near)
        rendered.append(np.clip(picture.rgb, 0, 1).transpose(2, 0, 1))
        alphas.append(picture.alpha)
        truth.append(target.image)
        distances = [np.linalg.norm(view.camera.center - target.camera.center) for view in seen]
        copies.append(seen[int(np.argmin(distances))].image)
    drawn = Drawn(np.stack([view.image for view in seen]), np.stack(truth), np.stack(rendered))
    ours, theirs, real = (torch.from_numpy(np.stack(x)) for x in (rendered, copies, truth))
    return Score(
        folder.name,
        context,
        targets,
        float(psnr(ours, real).mean()),
        float(gaussian_ssim(ours, real).mean()),
        float(psnr(theirs, real).mean()),
        float(gaussian_ssim(theirs, real).mean()),
        float((np.stack(alphas) < 0.5).mean()),
        float(sum(result.document["timings"].values())),
    ), drawn


def contact_sheet(drawn: Drawn) -> Image.Image:
    """Inputs on the left, then truth above and render below for each target."""
    columns = list(drawn.inputs) + list(drawn.truth)
    below = [np.zeros_like(image) for image in drawn.inputs] + list(drawn.rendered)
    rows = [np.concatenate(columns, axis=2), np.concatenate(below, axis=2)]
    pixels = np.concatenate(rows, axis=1).transpose(1, 2, 0)
    return Image.fromarray((pixels * 255 + 0.5).astype(np.uint8))


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m gapmes.export.score", description=__doc__.splitlines()[0])
    parser.add_argument("scenes", type=Path, nargs="+", help="folders with images/ and cameras.json")
    parser.add_argument("--inputs", type=int, choices=(2, 3), default=2, help="which suggested views to use")
    parser.add_argument("--model", type=Path, help="an exported file; the shipped one when left out")
    parser.add_argument("--out", type=Path, help="folder for one picture per scene and scores.json")
    options = parser.parse_args(arguments)
    reconstructor = Reconstructor(options.model)
    scores = []
    table = Table("scene", "PSNR", "SSIM", "copy PSNR", "copy SSIM", "holes %", "seconds")
    for folder in options.scenes:
        score, drawn = score_scene(folder, reconstructor, options.inputs)
        scores.append(score)
        table.add_row(
            score.scene,
            f"{score.psnr:.2f}",
            f"{score.ssim:.3f}",
            f"{score.copy_psnr:.2f}",
            f"{score.copy_ssim:.3f}",
            f"{100 * score.holes:.2f}",
            f"{score.seconds:.2f}",
        )
        if options.out:
            options.out.mkdir(parents=True, exist_ok=True)
            contact_sheet(drawn).save(options.out / f"{score.scene}_{options.inputs}views.png")
    mean = [np.mean([getattr(s, k) for s in scores]) for k in ("psnr", "ssim", "copy_psnr", "copy_ssim")]
    table.add_row("mean", f"{mean[0]:.2f}", f"{mean[1]:.3f}", f"{mean[2]:.2f}", f"{mean[3]:.3f}", "", "")
    Console().print(table)
    if options.out:
        rows = [score.__dict__ for score in scores]
        (options.out / f"scores_{options.inputs}views.json").write_text(json.dumps(rows, indent=2) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
