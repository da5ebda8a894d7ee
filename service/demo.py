"""The demonstration: the packaged sample scene through a real service, to a .ply, novel views and a comparison."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from PIL import Image

from .local_server import checked, local_client, local_server, wait_until_ready
from .pictures.contact_sheet import Cell, Row, contact_sheet
from .pictures.picture import encode_image
from .pictures.picture_error import psnr
from .process.disk import named, replace_file
from .process.terminal import ProgressBars
from .progress import Stage, Stages
from .settings import checked_settings
from .shipped import sample_folder

REQUEST_TIMEOUT_S = 600.0  # two views take seconds; a machine under load may take minutes


@dataclass(frozen=True)
class DemoResult:
    """What was written, and how well the novel views match the photographs that were held back."""

    scene_id: str
    address: str
    pid: int
    psnr: tuple[float, ...]  # dB, one per target view
    files: tuple[Path, ...]


def run_demo(output: Path, bars: ProgressBars, *, keep: bool = False) -> DemoResult:
    """Write scene.ply, view_<i>.png and comparison.png into `output`; the service is left running only with `keep`,
    then on the port of the settings if that is free."""
    port = checked_settings().port if keep else 0  # refused before anything is made
    output.mkdir(parents=True, exist_ok=True)
    log = output / "server.log"
    stages = Stages(bars)
    with ExitStack() as stack:
        sample = sample_folder()
        cameras = json.loads((sample / "cameras.json").read_text(encoding="utf-8"))
        context, targets = cameras["suggested"]["context2"], cameras["suggested"]["target2"]
        store = stack.enter_context(_store(output, keep))
        address, process = stack.enter_context(local_server(log, store=store, keep=keep, port=port))
        bars.say(f"service: {address}/ (log in {log})")
        client = stack.enter_context(local_client(address, REQUEST_TIMEOUT_S))
        wait_until_ready(client, process, log, stages)
        scene = _reconstruct(client, sample, cameras, context, stages, bars)
        with stages.stage("fetch .ply"):
            ply = output / "scene.ply"
            _write(ply, checked(client.get(scene["links"]["ply"])).content)
        renders = _render(client, scene["id"], cameras, targets, output, stages)
        with stages.stage("compare"):
            truths = [_pixels(sample / cameras["views"][index]["image"]) for index in targets]
            inputs = [_pixels(sample / cameras["views"][index]["image"]) for index in context]
            drawn = [_pixels(path) for path in renders]
            scores = [psnr(picture, truth) for picture, truth in zip(drawn, truths, strict=True)]
            comparison = output / "comparison.png"
            _write(comparison, encode_image(_sheet(context, inputs, targets, truths, drawn, scores), "png"))
    return DemoResult(scene["id"], address, process.pid, tuple(scores), (ply, *renders, comparison))


@contextmanager
def _store(output: Path, keep: bool) -> Iterator[Path]:
    """An empty folder for scenes, so that every run measures the work itself; it stays with `keep` and no failure."""
    store, done = Path(tempfile.mkdtemp(prefix="scenes-", dir=output)), False
    try:
        yield store
        done = True
    finally:
        if not (keep and done):
            shutil.rmtree(store, ignore_errors=True)


def _write(path: Path, data: bytes) -> None:
    with named(path):
        replace_file(path, data)


def _reconstruct(
    client: httpx.Client,
    sample: Path,
    cameras: dict[str, Any],
    context: Sequence[int],
    stages: Stages,
    bars: ProgressBars,
) -> dict[str, Any]:
    """Post the context photographs with the whole camera file; the service pairs them by name."""
    names = [cameras["views"][index]["image"] for index in context]
    form = [("images", (Path(name).name, (sample / name).read_bytes(), "image/png")) for name in names]
    form.append(("cameras", ("cameras.json", json.dumps(cameras).encode(), "application/json")))
    with stages.stage("reconstruct"):
        scene = checked(client.post("/reconstruct", files=form)).json()
    for name, seconds in scene["timings"].items():
        bars(Stage(f"  {name}", 1, 1, seconds))
    return scene


def _render(
    client: httpx.Client, scene_id: str, cameras: dict[str, Any], targets: Sequence[int], output: Path, stages: Stages
) -> list[Path]:
    """Draw the scene from the cameras of the photographs that were not used."""
    paths = []
    with stages.stage("render views", len(targets)) as step:
        for number, index in enumerate(targets):
            camera = json.dumps(cameras["views"][index])
            picture = checked(client.get("/render", params={"scene": scene_id, "camera": camera})).content
            paths.append(output / f"view_{number}.png")
            _write(paths[-1], picture)
            step(len(paths))
    return paths


def _sheet(
    context: Sequence[int],
    inputs: Sequence[np.ndarray],
    targets: Sequence[int],
    truths: Sequence[np.ndarray],
    renders: Sequence[np.ndarray],
    scores: Sequence[float],
) -> Image.Image:
    """Inputs, the pictures that were held back, and the renders with their PSNR in dB; pictures are (H, W, 3) uint8."""
    titles = [f"view {index}" for index in targets]
    rows = (
        ("Inputs", inputs, [f"view {index}" for index in context]),
        ("Truth, held back", truths, titles),
        ("Renders", renders, [f"{title}   {score:.1f} dB PSNR" for title, score in zip(titles, scores, strict=True)]),
    )
    return contact_sheet(
        [Row(title, [Cell(*cell) for cell in zip(pictures, labels, strict=True)]) for title, pictures, labels in rows]
    )


def _pixels(path: Path) -> np.ndarray:
    """(H, W, 3) uint8 of a picture's file."""
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))
