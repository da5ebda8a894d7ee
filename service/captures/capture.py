"""Opening captures, and choosing views: cameras, paths of photographs, and the reason of the choice."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from ..cameras.camera_fields import CameraFile
from ..cameras.depth_range import depth_range
from ..cameras.distortion import MAX_SHIFT_PX
from ..cameras.view_checks import MAX_VIEWS, MIN_VIEWS, Notice, check_count
from ..errors import CaptureError, ImageError, IntrinsicsError
from ..photographs.image_files import MAX_PIXELS
from .archive import SIGNATURES, ZipFiles
from .choose import chosen_views
from .colmap import folders_below_project, is_of_colmap
from .files import Files, FolderFiles
from .photographs import FOLDERS, Photographs
from .recognise import MAX_CAMERA_BYTES, recognised, table_of_file
from .select import DEFAULT_CONTEXT, ViewSelection, several_named_views
from .table import CameraTable
from .usable import usable_views

# Indices of the views to read, from their number, in this order.
Choice = Callable[[int], Sequence[int]]


@dataclass(frozen=True)
class ChosenViews:
    """Chosen views of a capture; photographs are not read yet."""

    file: CameraFile  # the chosen views alone
    paths: tuple[str, ...]  # of their photographs in the capture
    photographs: Photographs
    indices: tuple[int, ...]  # of the views in the camera file
    selection: dict[str, Any]  # JSON values: how they were chosen, of how many
    warnings: tuple[Notice, ...]

    def read(self, place: int) -> bytes:
        """The encoded photograph of a chosen view."""
        return self.photographs.read(self.paths[place])

    def checked_depths(self, near: float | None, far: float | None) -> tuple[float | None, float | None]:
        """Near and far: each as it is given here, else the file's.

        Raises `ViewCountError`, `DepthRangeError` and `BaselineError`, as a reconstruction would: photographs and
        network need not be read for that.
        """
        check_count(len(self.indices))
        near, far = self.file.depths(near, far)
        depth_range(self.file.cameras, near, far)
        return near, far


class Capture:
    """The cameras of a capture, and the files among which their photographs are."""

    def __init__(self, files: Files, base: str, table: CameraTable, *, max_pixels: int = MAX_PIXELS) -> None:
        beside = table.source.rpartition("/")[0]
        self.files = files
        self.table = table
        self._photographs = Photographs(files, base, beside, table.names, max_pixels)
        self._paths: list[str] | None = None  # of photographs by order, if the file has no names

    @classmethod
    def of(cls, files: Files, *, max_pixels: int = MAX_PIXELS, max_camera_bytes: int = MAX_CAMERA_BYTES) -> Capture:
        """The capture in a folder or zip, see `recognised`. Raises `CaptureError` and `CameraError`."""
        return cls(files, *recognised(files, max_camera_bytes), max_pixels=max_pixels)

    @property
    def names(self) -> tuple[str | None, ...]:
        """Names of the views' photographs: those of the file, else paths by order. Raises `CaptureError` if their
        numbers differ."""
        return tuple(self._in_order()) if self.table.by_sorted_name else self.table.names

    def cameras(self, indices: Sequence[int]) -> CameraFile:
        """The cameras of these views; photographs are opened for their sizes if the file has none."""
        return self.table.parse(indices, self._size_of)

    @cached_property
    def by_sorted_name(self) -> bool:
        """Whether view i belongs to photograph i, sorted by name: if the file has no names, or if its names are time
        stamps and no photograph is named like another view than it has by order."""
        if self.table.by_sorted_name or self.table.kind != "realestate10k":
            return self.table.by_sorted_name
        named = {index: path for index in range(len(self.table.names)) if (path := self._named(index))}
        if len(named) in (0, len(self.table.names)):
            return not named
        try:
            return all(self._in_order()[index] == path for index, path in named.items())
        except CaptureError:  # other numbers of photographs and views
            return False

    def path_of(self, index: int) -> str:
        """Path of the photograph of a view. Raises `ImageError` if it is missing."""
        if self.by_sorted_name:
            return self._in_order()[index]
        return self._photographs.find(self.table.names[index], index)

    def _named(self, index: int) -> str | None:
        """Path of the photograph with the name of this view, None if there is none."""
        try:
            return self._photographs.find(self.table.names[index], index)
        except ImageError:
            return None

    def choose(self, wanted: ViewSelection, near: float | None = None, far: float | None = None) -> ChosenViews:
        """The requested views; `near` and `far` of the user override those of the file.

        Without a request all views of a capture of up to six. In a larger one views are chosen among those with a
        photograph and a usable camera; a warning names unusable cameras. Raises `ViewError`, `ImageError`,
        `CameraError` and `CaptureError`.
        """
        count = len(self.table.names)
        said: dict[str, Any] = {"format": self.table.kind, "cameras": self.table.source, "of": count}
        if wanted.select is not None:
            indices = several_named_views(wanted.select, self.names, field=wanted.field, path_of=self._found)
            return self.views(indices)
        if wanted.context is None and count <= MAX_VIEWS:
            indices = list(range(count))
            return self._chosen(self.cameras(indices), indices, {"by": "all", **said})
        there = self.with_photograph()
        said["without_photograph"] = count - len(there)
        if wanted.context is None and len(there) <= MAX_VIEWS:
            return self._chosen(self.cameras(there), there, {"by": "photographs", **said})
        there, file, warnings = usable_views(there, self.cameras)
        choice = chosen_views(file.cameras, wanted.context or DEFAULT_CONTEXT, file.middles(near, far))
        indices = [there[place] for place in choice.places]
        return self._chosen(file.chosen(choice.places), indices, {"by": "score", **said, **choice.said}, warnings)

    def views(self, indices: Sequence[int]) -> ChosenViews:
        """The views with these indices, in this order. Raises `ImageError`, `CameraError` and `CaptureError`."""
        said = {"format": self.table.kind, "cameras": self.table.source, "of": len(self.table.names)}
        return self._chosen(self.cameras(indices), indices, {"by": "select", **said})

    def with_photograph(self) -> list[int]:
        """Indices of the views whose photograph is there. Raises `ImageError` where fewer than two are."""
        there, first = [], None
        for index in range(len(self.table.names)):
            try:
                self.path_of(index)
                there.append(index)
            except ImageError as error:
                first = first or error
        if len(there) < MIN_VIEWS and first is not None:
            raise first
        return there

    def _found(self, index: int) -> str | None:
        try:
            return self.path_of(index)
        except ImageError:
            return None

    def _chosen(
        self, file: CameraFile, indices: Sequence[int], said: dict[str, Any], warnings: tuple[Notice, ...] = ()
    ) -> ChosenViews:
        paths = tuple(self.path_of(index) for index in indices)
        for place, path in enumerate(paths):
            if (first := paths.index(path)) < place:
                message = f"{path} is the photograph of view {indices[first]} too"
                cure = "name one photograph for each view, with its folder where names are the same"
                raise ImageError(message, field="views.image", index=indices[place], cure=cure)
        said = {**said, "views": list(indices), "images": list(paths)}
        return ChosenViews(file, paths, self._photographs, tuple(indices), said, self.table.warnings + warnings)

    def _in_order(self) -> list[str]:
        if self._paths is None:
            numbered = self.table.kind == "realestate10k"  # frames of a film; LLFF sorts as text
            self._paths = self._photographs.in_order(len(self.table.names), by_number=numbered)
        return self._paths

    def _size_of(self, name: str | None, index: int) -> tuple[int, int]:
        return self._photographs.size_of(self.path_of(index), index)


def open_capture(path: str | Path) -> Capture:
    """Open a folder, a .zip or a camera file beside its photographs, recognised by content.

    A zip stays open as long as the capture exists. Raises `CaptureError` and `CameraError`.
    """
    path = Path(path)
    if path.is_dir():
        base, table = recognised(FolderFiles(path))
        file = path / table.source
        root = _root_of(file)
        within = folders_below_project(Path(table.source).parent)
        if not within and root in Path(os.path.abspath(path)).parents:  # the folder of a model, or of models
            return _of_file(root, file, table)
        return Capture(FolderFiles(path), base, table)
    if not path.is_file():
        raise CaptureError(f"{path} does not exist", field="capture", cure="give a folder, a .zip or a camera file")
    with ExitStack() as opened:
        try:
            stream = opened.enter_context(path.open("rb"))
        except OSError as error:
            cure = "ask who owns it for permission"
            raise CaptureError(f"{path} cannot be read: {error.strerror}", field="capture", cure=cure) from error
        if stream.read(4) in SIGNATURES:
            capture = Capture.of(ZipFiles(stream, str(path)))
            opened.pop_all()
            return capture
    return _of_file(_root_of(path), path)


def _of_file(root: Path, path: Path, table: CameraTable | None = None) -> Capture:
    """The capture whose camera file, already read into `table` or not, is at `path`, below `root`."""
    files, source = FolderFiles(root), Path(os.path.relpath(path, root)).as_posix()
    return Capture(files, "", table_of_file(files, source) if table is None else replace(table, source=source))


def _root_of(path: Path) -> Path:
    """The folder in which photographs of a camera file are searched: its own, or for a COLMAP model without photographs
    beside it that of the project, the folder above `sparse`, or above nerfstudio's `colmap` where that has none."""
    above = folders_below_project(Path(os.path.abspath(path.parent))) if is_of_colmap(path.name) else 0
    places = [path.parent, *Path(os.path.abspath(path.parent)).parents[:above]]
    return next((place for place in places if _has_photographs(place)), places[-1])


def _has_photographs(place: Path) -> bool:
    return any((place / name).is_dir() for name in FOLDERS if name)


def read_camera_file(path: str | Path) -> CameraFile:
    """All cameras of a camera file, a folder or a .zip; photographs are needed only for sizes that it lacks. Raises
    `CameraError`, `CaptureError` and `ImageError`.
    """
    capture = open_capture(path)
    return capture.cameras(range(len(capture.table.names)))


@dataclass(frozen=True)
class SceneFolder:
    """A folder with a camera file and the photographs of its chosen views, one path per view."""

    file: CameraFile  # the chosen views alone
    image_paths: tuple[Path, ...]
    indices: tuple[int, ...]  # of the chosen views in the file


def load_scene_folder(path: str | Path, choose: Choice | None = None) -> SceneFolder:
    """The views of a folder or camera file without lens distortion, and the paths of their photographs.

    `choose` selects views; photographs of others may be missing. Raises `CameraError` for a missing or malformed file,
    `IntrinsicsError` for a distorted lens, and `ImageError` for a missing photograph.
    """
    path = Path(path)
    capture = open_capture(path)
    if not isinstance(capture.files, FolderFiles):
        raise CaptureError(f"{path} is a zip, need a folder or a camera file", field="capture", cure="unpack it")
    count = len(capture.table.names)
    indices = tuple(range(count) if choose is None else choose(count))
    file = capture.cameras(indices)
    for index, view in zip(indices, file.views, strict=True):
        if view.lens is not None:
            shift = view.lens.largest_shift()
            message = f"distortion moves a point of the picture by {shift:.3g} px, need less than {MAX_SHIFT_PX:g} px"
            raise IntrinsicsError(message, field="cameras.distortion", index=index, cure="undistort the photographs")
    root = capture.files.root
    return SceneFolder(file, tuple(root / capture.path_of(index) for index in indices), indices)
