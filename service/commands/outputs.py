"""What `gapmes render` writes: pictures in a folder, a film, or a contact sheet."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from ..pictures.effort import Effort, draw
from ..pictures.film import FILM_FORMATS, FilmFormat, FilmShape, check_film, most_frames, write_film
from ..pictures.picture import MAX_SIDE, Channel, Format, encode, encode_image
from ..problem_document import plain
from ..process.disk import named, replace_file
from ..progress import Stages
from ..viewpoints.camera_path import PathName, loop
from ..viewpoints.framing import even, within
from ..viewpoints.scene_views import SceneViews

if TYPE_CHECKING:
    from ..cameras.camera import Camera
    from ..gaussians import Gaussians
    from ..splat import Render

LISTED = 5  # empty pictures that the warning names
REASONS = {  # why the splatter left Gaussians out
    "near": "before the near plane at z-depth {near:.4g}",
    "far": "beyond z-depth 1e37",
    "faint": "fainter than alpha_min",
    "not_finite": "without a finite extent",
    "outside": "beside the picture",
}
SECONDS, FPS = 4.0, 24.0
NO_FOLDER = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".avi", ".mov", ".mkv", ".webm", ".m4v", ".mpg")
SHEET_FORMATS: dict[str, Format] = {".png": "png", ".jpg": "jpeg", ".jpeg": "jpeg", ".webp": "webp"}


@dataclass(frozen=True, eq=False)
class Drawing:
    """A scene, the cameras of the views that were asked for, and how to draw them."""

    gaussians: Gaussians
    scene: SceneViews
    specs: Sequence[str]
    fit: Callable[[Camera], Camera]  # crop and size that were asked for
    channel: Channel
    effort: Effort
    options: dict[str, Any]
    empty: dict[str, Mapping[str, int]] = field(default_factory=dict)  # pictures of no Gaussian: culled, by reason

    @property
    def shots(self) -> list[Camera]:
        """The cameras of the views, as they are drawn."""
        return [self.fit(self.scene.resolve(spec, field="views")) for spec in self.specs]

    def draw(self, camera: Camera, name: str) -> Render:
        """One picture; one that shows no Gaussian is noted in `empty` under its name."""
        drawn = draw(self.gaussians, camera, self.channel, self.effort, **self.options, **self.scene.near_plane)
        if not drawn.stats["projected"]:
            self.empty[name] = drawn.stats["culled"]
        return drawn


@dataclass(frozen=True)
class FilmPlan:
    """A film that was asked for."""

    format: FilmFormat
    path: PathName = "turntable"
    seconds: float = SECONDS
    fps: float | None = None  # as asked for; `FPS` where it is not
    swing: float | None = None
    even: bool = False  # whether the size may be cropped to what the format needs

    @classmethod
    def asked(cls, output: Path, channel: Channel, sheet: bool, sized: bool, **given: Any) -> FilmPlan | None:
        """None where neither the name of the file nor an option asks for one. Raises `InputError`."""
        given = {name: value for name, value in given.items() if value is not None}
        ending = output.suffix.lower().removeprefix(".")
        if sheet or ending not in FILM_FORMATS:
            if given:
                raise InputError(
                    f"goes with a film, and {output.name!r} is {'a sheet' if sheet else 'none'}",
                    field=next(iter(given)),
                    cure=f"name a file that ends in one of {', '.join(f'.{name}' for name in FILM_FORMATS)}",
                )
            return None
        if channel != "rgb":
            raise InputError(f"a film shows rgb, not {channel}", field="channel", cure="draw pictures into a folder")
        return cls(ending, even=ending == "mp4" and not sized, **given)

    def fit(self, camera: Camera) -> Camera:
        """The frame of this format."""
        return even(camera) if self.even else camera

    def shape(self, camera: Camera) -> FilmShape:
        """Of the film whose frames are those of `camera`. Raises `InputError` for what cannot be written."""
        frames = min(round(self.seconds * (self.fps or FPS)), most_frames(self.seconds))
        shape = FilmShape(self.format, camera.width, camera.height, frames, self.seconds)
        check_film(shape)
        return shape

    def notes(self, shape: FilmShape) -> list[str]:
        """A sentence where whole frames do not come at the rate that was asked for."""
        if self.fps is None or math.isclose(shape.fps, self.fps):
            return []
        return [f"{shape.frames} frames in {shape.seconds:g} s are {shape.fps:.4g} per second, not {self.fps:g}"]


def names_file(output: Path) -> bool:
    """Whether a name that is neither of a film nor of a sheet is meant for a file nevertheless, `.webp` alone too."""
    ending = (output.suffix or output.name).lower()
    return ending in (*NO_FOLDER, *(f".{film}" for film in FILM_FORMATS))


def empty_pictures(drawing: Drawing) -> list[str]:
    """A sentence where pictures show no Gaussian at all: which, why the first of them does not, and the likely cure."""
    from ..splat import Definition

    if not drawing.empty:
        return []
    names = list(drawing.empty)
    near = drawing.scene.near_plane.get("near", Definition.near)
    culled = {reason: count for reason, count in drawing.empty[names[0]].items() if count}
    why = ", ".join(f"{count} {REASONS[reason].format(near=near)}" for reason, count in culled.items())
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    cure = "lower --alpha-min"
    if set(culled) != {"faint"}:
        cure = "do scene and cameras have the same unit, origin and axes? near puts the near plane at a tenth of it"
    return [
        f"{', '.join(names[:LISTED])}{more}: none of {len(drawing.gaussians)} Gaussians is drawn "
        f"({names[0]}: {why or 'there are none'}; {cure})"
    ]


def write_pictures(drawing: Drawing, folder: Path, depth_scale: float | None, stages: Stages) -> list[dict[str, Any]]:
    """A PNG for each view, named view_<view>.png; returns what each is."""
    with named(folder):
        folder.mkdir(parents=True, exist_ok=True)
    written: list[dict[str, Any]] = []
    with stages.stage("render", len(drawing.specs)) as step:
        for spec, camera in zip(drawing.specs, drawing.shots, strict=True):
            drawn = drawing.draw(camera, f"view {spec}")
            picture = encode(drawn, drawing.channel, depth_scale=depth_scale)
            path = folder / f"view_{spec.replace(':', '_')}.png"
            with named(path):
                replace_file(path, picture.data)
            entry = {"view": spec, "file": str(path), "width": camera.width, "height": camera.height}
            entry |= {"stats": plain(drawn.stats)}
            if picture.depth is not None:
                entry |= {"depth_range": (picture.depth.low, picture.depth.high)}
                entry |= {"depth_scale": picture.depth.scale, "depth_offset": picture.depth.offset}
            written.append(entry)
            step(len(written))
    return written


def write_moving(drawing: Drawing, output: Path, plan: FilmPlan, stages: Stages) -> dict[str, Any]:
    """The film of a path among the views; frames go into the file as they are drawn. Returns what it is, and the least
    and the largest number of Gaussians in a frame."""
    among = replace(drawing.scene, cameras=[drawing.scene.resolve(spec, field="views") for spec in drawing.specs])
    path = among.path(plan.path, plan.swing)
    shape = plan.shape(plan.fit(drawing.fit(path(0.0))))
    projected: list[int] = []

    def frames(step: Callable[[int], None]) -> Iterator[Any]:
        for number, camera in enumerate(loop(path, shape.frames)):
            drawn = drawing.draw(plan.fit(drawing.fit(camera)), f"frame {number}")
            projected.append(drawn.stats["projected"])
            yield drawn.rgb8()
            step(number + 1)

    with stages.stage("render film", shape.frames) as step, named(output):
        write_film(output, shape, frames(step))
    said = {"file": str(output), "path": plan.path, "fps": shape.fps, **vars(shape)}
    return said | {"projected": (min(projected), max(projected))}


def check_sheet(output: Path, shots: Sequence[Camera]) -> None:
    """Raises `InputError` where a sheet of these views does not fit the format of the file."""
    from ..pictures.contact_sheet import CELL, in_rows, sheet_size

    cells = [within(camera, CELL) for camera in shots]
    size = sheet_size(in_rows([(cell.width, cell.height) for cell in cells]))
    format = SHEET_FORMATS[output.suffix.lower()]
    for name, side in zip(("width", "height"), size, strict=True):
        if side > MAX_SIDE[format]:
            raise InputError(
                f"{name} of {len(shots)} views is {side} px, the limit of {format} is {MAX_SIDE[format]}",
                field="sheet",
                cure="write .png, or fewer --views",
            )


def write_sheet(drawing: Drawing, output: Path, stages: Stages) -> dict[str, Any]:
    """All views in one picture. Returns what it is."""
    from ..pictures.contact_sheet import CELL, Cell, contact_sheet, rows_of

    cells, stats = [], []
    with stages.stage("render", len(drawing.specs)) as step:
        for spec, camera in zip(drawing.specs, drawing.shots, strict=True):
            drawn = drawing.draw(within(camera, CELL), f"view {spec}")
            cells.append(Cell(drawn.rgb8(), f"view {spec}"))
            stats.append(plain(drawn.stats))
            step(len(cells))
    sheet = contact_sheet(rows_of("Views", cells))
    with named(output):
        replace_file(output, encode_image(sheet, SHEET_FORMATS[output.suffix.lower()]))
    size = {"width": sheet.width, "height": sheet.height}
    return {"file": str(output), "views": list(drawing.specs), **size, "stats": stats}
