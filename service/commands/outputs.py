"""The outputs of `gapmes render`: pictures in a folder, a film, or a contact sheet."""

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
from ..process.output_file import check_output_folder
from ..progress import Stages
from ..viewpoints.camera_path import Path as CameraPath
from ..viewpoints.camera_path import PathName, loop
from ..viewpoints.framing import even, within
from ..viewpoints.scene_views import SceneViews

if TYPE_CHECKING:
    from ..cameras.camera import Camera
    from ..gaussians import Gaussians
    from ..splat import Render

LISTED = 5  # number of empty pictures that the warning names
REASONS = {  # texts for the splatter's reasons for culling
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
    """A scene, the requested views, and how to draw them."""

    gaussians: Gaussians
    scene: SceneViews
    specs: Sequence[str]
    fit: Callable[[Camera], Camera]  # to the requested crop and size
    channel: Channel
    effort: Effort
    options: dict[str, Any]
    empty: dict[str, Mapping[str, int]] = field(default_factory=dict)  # pictures without Gaussians: culled, by reason

    @property
    def shots(self) -> list[Camera]:
        """The cameras of the views, cropped and sized."""
        return [self.fit(self.scene.resolve(spec, field="views")) for spec in self.specs]

    def draw(self, camera: Camera, name: str) -> Render:
        """Draw a picture; one without any Gaussian is added to `empty` under `name`."""
        drawn = draw(self.gaussians, camera, self.channel, self.effort, **self.options, **self.scene.near_plane)
        if not drawn.stats["projected"]:
            self.empty[name] = drawn.stats["culled"]
        return drawn


@dataclass(frozen=True)
class FilmPlan:
    """A requested film."""

    format: FilmFormat
    path: PathName = "turntable"
    seconds: float = SECONDS
    fps: float | None = None  # as requested; None for `FPS`
    swing: float | None = None
    even: bool = False  # whether to crop odd sides, which MP4 does not support

    @classmethod
    def asked(cls, output: Path, channel: Channel, sheet: bool, sized: bool, **given: Any) -> FilmPlan | None:
        """The film that the output's suffix asks for, else None. Raises `InputError` for options that need a film."""
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

    def among(self, scene: SceneViews, specs: Sequence[str]) -> CameraPath:
        """The film's path among these views of a scene. Raises `ViewError`."""
        cameras = [scene.resolve(spec, field="views") for spec in specs]
        return replace(scene, cameras=cameras).path(self.path, self.swing)

    def fit(self, camera: Camera) -> Camera:
        """The camera with sides that the format supports."""
        return even(camera) if self.even else camera

    def shape(self, camera: Camera) -> FilmShape:
        """The film's shape, with the picture size of `camera`. Raises `InputError` if it cannot be written."""
        frames = min(round(self.seconds * (self.fps or FPS)), most_frames(self.seconds))
        shape = FilmShape(self.format, camera.width, camera.height, frames, self.seconds)
        check_film(shape)
        return shape

    def notes(self, shape: FilmShape) -> list[str]:
        """A sentence if the number of frames does not give the requested rate."""
        if self.fps is None or math.isclose(shape.fps, self.fps):
            return []
        return [f"{shape.frames} frames in {shape.seconds:g} s are {shape.fps:.4g} per second, not {self.fps:g}"]


def check_folder(output: Path) -> None:
    """Raises `InputError` if pictures cannot be written into a folder at `output`, also where it looks like a file, by
    its suffix or as a bare suffix such as `.webp`."""
    ending = (output.suffix or output.name).lower()
    if not output.is_dir() and ending in (*NO_FOLDER, *(f".{film}" for film in FILM_FORMATS)):
        raise InputError(
            f"{output.name!r} names a file, and pictures go into a folder",
            field="output",
            cure="name a folder; a film ends in .mp4, .webp or .gif; --sheet puts all views into one picture",
        )
    check_output_folder(output)


def empty_pictures(drawing: Drawing) -> list[str]:
    """A sentence about pictures without any Gaussian: which, why for the first of them, and the likely cure."""
    from ..splat import Definition

    if not drawing.empty:
        return []
    names = list(drawing.empty)
    near = drawing.scene.near_plane.get("near", Definition.near)
    culled = {reason: count for reason, count in drawing.empty[names[0]].items() if count}
    why = ", ".join(f"{count} {REASONS[reason].format(near=near)}" for reason, count in culled.items())
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    cure = "lower --alpha-min"
    if not len(drawing.gaussians):
        cure = "is it the right file, and whole?"
    elif set(culled) != {"faint"}:
        cure = "do scene and cameras have the same unit, origin and axes? near puts the near plane at a tenth of it"
    return [
        f"{', '.join(names[:LISTED])}{more}: none of {len(drawing.gaussians)} Gaussians is drawn "
        f"({names[0]}: {why or 'there are none'}; {cure})"
    ]


def write_pictures(drawing: Drawing, folder: Path, depth_scale: float | None, stages: Stages) -> list[dict[str, Any]]:
    """Write view_<view>.png for each view; returns an entry for the JSON result for each."""
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
    """Write the film of a path among the views, frame by frame. Returns its entry for the JSON result, with the
    smallest and the largest number of Gaussians in a frame."""
    path = plan.among(drawing.scene, drawing.specs)
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


def check_sheet(output: Path, channel: Channel, shots: Sequence[Camera]) -> None:
    """Raises `InputError` unless a sheet shows rgb, in a format that holds one, within the limit of its sides."""
    from ..pictures.contact_sheet import CELL, in_rows, sheet_size

    if channel != "rgb":
        raise InputError(f"a sheet shows rgb, not {channel}", field="channel", cure="leave it out")
    if output.suffix.lower() not in SHEET_FORMATS:
        message = f"is one file, and {output.name!r} does not end in one of {', '.join(SHEET_FORMATS)}"
        example = output.with_suffix(".png") if output.name else "sheet.png"
        raise InputError(message, field="sheet", cure=f"name a file, such as {example}")
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
    """Write a contact sheet of all views. Returns its entry for the JSON result."""
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
