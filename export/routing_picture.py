"""A picture of the routes of patches: `python -m gapmes.export.routing_picture SCENE_DIR --out FILE.png`.

Per photograph: the experts of each patch in order, its strongest task, and every task's weight as a map over it.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Patch
from numpy.typing import NDArray

from gapmes.service.captures.capture import load_scene_folder
from gapmes.service.commands.selection import view_indices
from gapmes.service.errors import GapmesError, InputError, ModelError
from gapmes.service.photographs.images import EncodedPhoto
from gapmes.service.process.output_file import check_output_file
from gapmes.service.process.terminal import ProgressBars
from gapmes.service.progress import Listener, silent
from gapmes.service.reconstruct import Reconstructor
from gapmes.service.shipped import sample_folder

from .recording_engine import RecordingEngine

F32 = NDArray[np.float32]

TASKS = ("mean μ", "opacity α", "covariance Σ", "colour c")  # in the order of `task_weight`
EXPERT_COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9", "#f0e442", "#5b3a8e")  # Okabe, Ito
TASK_COLOURS = ("#1b3fd6", "#e8c31c", "#c0161d", "#19b35a")  # apart from those of the experts
ENDINGS = (".png", ".svg", ".pdf")
ORDINALS = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth")
WEIGHTS = colormaps["viridis"]  # of task weights, from 0 to 1
TINT = 0.62  # share of the colour over the grey photograph: both stay legible
CELL_PX, WIDTH_PX, LEGEND_PX, DPI = 200, 900, 125, 100
COLUMNS = 4
_LEGEND: dict[str, Any] = {
    "loc": "upper left",
    "frameon": False,
    "fontsize": 9,
    "title_fontsize": 9.5,
    "alignment": "left",
}


@dataclass(frozen=True, eq=False)
class Routed:
    """V photographs as the network saw them and the routes of their P patches, row-major; None for a missing gate.

    Masked patches have weights 0.
    """

    photos: F32  # (V, 3, H, W) in [0, 1]
    views: tuple[int, ...]  # indices in the camera file
    patch: int  # px
    tall: float  # height of a pixel by its width: the network sees photographs resampled to its own aspect
    experts: int
    expert_index: NDArray[np.int64] | None  # (V, P, k), best first
    expert_weight: F32 | None  # (V, P, k)
    task_weight: F32 | None  # (V, P, 4)


def route(folder: Path, views: list[str], model: Path | None = None, listener: Listener = silent) -> Routed:
    """Reconstruct a scene from some of its views and return the routes.

    Raises `GapmesError` as the service does, and `ModelError` for a network without gates.
    """
    scene = load_scene_folder(folder, lambda count: view_indices(",".join(views), count))
    engine = RecordingEngine(model)
    if not {"expert_index", "task_weight"} & set(engine.outputs):
        raise ModelError("has neither experts nor a task gate: there are no routes to show", field="model")
    photos = [EncodedPhoto(path.read_bytes()) for path in scene.image_paths]
    near, far = scene.file.near, scene.file.far
    found = Reconstructor(engine).reconstruct(  # mending changes no route
        photos, scene.file.cameras, near=near, far=far, leave_one_out=0, fade=0, listener=listener
    )
    upright = next(  # most are
        camera
        for camera, crop in zip(found.view_cameras, found.document["crop"], strict=True)
        if crop["turned_degrees"] % 180 == 0
    )
    height, width = engine.info.shape
    return Routed(
        engine.images,
        scene.indices,
        engine.info.patch,
        (upright.height / height) / (upright.width / width),
        int(engine.info.config["experts"]),
        engine.last.get("expert_index"),
        engine.last.get("expert_weight"),
        engine.last.get("task_weight"),
    )


def tinted(photo: F32, colours: NDArray[np.float64], patch: int) -> NDArray[np.float64]:
    """(H, W, 3): the photograph (3, H, W) in grey, tinted by patch colours (P, 3); a patch of NaN is not changed."""
    height, width = photo.shape[1:]
    blocks = colours.reshape(height // patch, width // patch, 3).repeat(patch, axis=0).repeat(patch, axis=1)
    grey = np.tensordot([0.299, 0.587, 0.114], photo, axes=1)[..., None]
    return np.where(np.isnan(blocks), photo.transpose(1, 2, 0), (1 - TINT) * grey + TINT * blocks)


def chosen_colours(choice: NDArray[np.int64], kept: NDArray[np.bool_], colours: list[str]) -> NDArray[np.float64]:
    """(P, 3) the colour of each patch's choice (P,), NaN where the mask `kept` (P,) is False."""
    table = np.array([to_rgb(colour) for colour in colours])
    return np.where(kept[:, None], table[choice], np.nan)


def shares(choice: NDArray[np.int64], kept: NDArray[np.bool_], count: int) -> NDArray[np.float64]:
    """(count,) share of the kept patches that made each choice; 0 where no patch is kept."""
    return np.bincount(choice[kept], minlength=count) / max(1, int(kept.sum()))


def expert_colours(count: int) -> list[str]:
    """One colour per expert; more than eight are sampled from the hue circle."""
    if count <= len(EXPERT_COLOURS):
        return list(EXPERT_COLOURS[:count])
    return [to_hex(colormaps["hsv"](i / count)) for i in range(count)]


@dataclass(frozen=True, eq=False)
class Panel:
    """One picture with its title."""

    title: str
    pixels: NDArray[np.float64]  # (H, W, 3) in [0, 1]


def view_rows(routed: Routed, view: int) -> list[list[Panel]]:
    """Panels of one photograph, row by row, none longer than `COLUMNS`."""
    photo, patch = routed.photos[view], routed.patch
    choices = [Panel(f"view {routed.views[view]}", photo.transpose(1, 2, 0).astype(np.float64))]
    rows = [choices]
    if routed.expert_index is not None and routed.expert_weight is not None:
        index, weight = routed.expert_index[view], routed.expert_weight[view]
        kept = weight.sum(axis=1) > 0
        for place in range(index.shape[1]):
            colours = chosen_colours(index[:, place], kept, expert_colours(routed.experts))
            mean = float(weight[kept, place].mean()) if kept.any() else 0.0
            title = f"{_ordinal(place)} expert, weight {mean:.2f}"
            choices.append(Panel(title, tinted(photo, colours, patch)))
    if routed.task_weight is not None:
        weight = routed.task_weight[view]
        kept = weight.sum(axis=1) > 0
        colours = chosen_colours(weight.argmax(axis=1), kept, list(TASK_COLOURS))
        choices.append(Panel("strongest task", tinted(photo, colours, patch)))
        maps = []
        for task, name in enumerate(TASKS):
            colours = np.where(kept[:, None], WEIGHTS(weight[:, task])[:, :3], np.nan)
            maps.append(Panel(f"task weight: {name}", tinted(photo, colours, patch)))
        rows.append(maps)
    return [row[start : start + COLUMNS] for row in rows for start in range(0, len(row), COLUMNS)]


def draw_routing(routed: Routed) -> Figure:
    """All photographs below each other, then the legends with the shares over all of them."""
    rows = [row for view in range(len(routed.photos)) for row in view_rows(routed, view)]
    height, width = routed.photos.shape[2:]
    cell_height = CELL_PX * routed.tall * height / width + 24
    total = len(rows) * cell_height + LEGEND_PX
    layout = ConstrainedLayoutEngine(w_pad=0.04, h_pad=0.03, wspace=0.0, hspace=0.0)
    figure = Figure(figsize=(WIDTH_PX / DPI, total / DPI), dpi=DPI, layout=layout)
    grid = figure.add_gridspec(len(rows) + 1, COLUMNS, height_ratios=[cell_height] * len(rows) + [LEGEND_PX])
    for number, row in enumerate(rows):
        for column, panel in enumerate(row):
            axes = figure.add_subplot(grid[number, column])
            axes.imshow(panel.pixels.clip(0, 1), interpolation="nearest", aspect=routed.tall)
            axes.set_title(panel.title, fontsize=9.5, pad=3)
            axes.set_axis_off()
    legends = grid[len(rows), :].subgridspec(1, 3, width_ratios=[1.3, 1.2, 0.8])
    _expert_legend(figure.add_subplot(legends[0]), routed)
    _task_legend(figure.add_subplot(legends[1]), routed)
    _weight_scale(figure.add_subplot(legends[2]), routed)
    return figure


def _ordinal(place: int) -> str:
    """The ordinal of a choice counted from 0, in words up to the eighth, then 9th, 11th, 21st."""
    if place < len(ORDINALS):
        return ORDINALS[place]
    number = place + 1
    teens = number % 100 in (11, 12, 13)
    return f"{number}{'th' if teens else {1: 'st', 2: 'nd', 3: 'rd'}.get(number % 10, 'th')}"


def _expert_legend(axes: Axes, routed: Routed) -> None:
    axes.set_axis_off()
    if routed.expert_index is None or routed.expert_weight is None:
        return
    kept = routed.expert_weight.sum(axis=-1).ravel() > 0
    choices = routed.expert_index.reshape(-1, routed.expert_index.shape[-1])
    places = [shares(choice, kept, routed.experts) for choice in choices.T]
    handles = [
        Patch(color=colour, label=f"expert {e}: " + ", ".join(f"{100 * share[e]:.0f} %" for share in places))
        for e, colour in enumerate(expert_colours(routed.experts))
    ]
    title = f"experts: share of patches, {', '.join(map(_ordinal, range(len(places))))}"
    axes.legend(handles=handles, title=title, **_LEGEND, ncols=1 + (len(handles) > 4))


def _task_legend(axes: Axes, routed: Routed) -> None:
    axes.set_axis_off()
    if routed.task_weight is None:
        return
    weight = routed.task_weight.reshape(-1, len(TASKS))
    kept = weight.sum(axis=1) > 0
    strongest = shares(weight.argmax(axis=1), kept, len(TASKS))
    mean = weight.sum(axis=0) / max(1, int(kept.sum()))
    handles = [
        Patch(color=colour, label=f"{name}: {100 * strongest[t]:.0f} %, {mean[t]:.2f}")
        for t, (name, colour) in enumerate(zip(TASKS, TASK_COLOURS, strict=True))
    ]
    axes.legend(handles=handles, title="tasks: share where strongest, average weight", **_LEGEND)


def _weight_scale(axes: Axes, routed: Routed) -> None:
    axes.set_axis_off()
    if routed.task_weight is not None:
        inset = axes.inset_axes((0.05, 0.62, 0.9, 0.14))
        axes.figure.colorbar(ScalarMappable(cmap=WEIGHTS), cax=inset, orientation="horizontal", ticks=[0, 0.5, 1])
        inset.set_title("task weight", fontsize=9.5, pad=4)
        inset.tick_params(labelsize=9)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser("python -m gapmes.export.routing_picture", description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=Path, nargs="?", default=sample_folder(), help="default: the shipped sample")
    parser.add_argument("--views", nargs="+", default=["0", "1"], help="2 to 6 places in the camera file")
    parser.add_argument("--out", type=Path, required=True, help="picture to write: .png, .svg or .pdf")
    parser.add_argument("--model", type=Path, help="an exported file; the shipped one when left out")
    options = parser.parse_args(arguments)
    with ProgressBars() as bars:
        try:
            if options.out.suffix.lower() not in ENDINGS:  # said before the work, not after it
                raise InputError(f"{options.out.name!r} has another ending than {', '.join(ENDINGS)}", field="out")
            check_output_file(options.out, field="out")
            draw_routing(route(options.scene, options.views, options.model, bars)).savefig(options.out)
        except (GapmesError, ValueError, OSError) as error:
            bars.say(f"refused: {error}")
            return 1
        bars.say(f"written: {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
