"""A capture opened and its views chosen: cameras, where their photographs are, and why these."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from ..cameras.camera_fields import CameraFile
from ..cameras.distortion import MAX_SHIFT_PX
from ..cameras.view_checks import MAX_VIEWS, MIN_VIEWS, Notice
from ..errors import CaptureError, ImageError, IntrinsicsError
from ..photographs.image_files import MAX_PIXELS
from .archive import SIGNATURES, ZipFiles
from .choose import chosen_views
from .colmap import folders_below_project, is_of_colmap
from .files import Files, FolderFiles
from .photographs import FOLDERS, Photographs
from .recognise import MAX_CAMERA_BYTES, recognised, table_of_file
from .select import DEFAULT_CONTEXT, Wish, several_named_views
from .table import CameraTable
from .usable import usable_views

# Which views of a file to read, given how many it has; the order is kept.
Choice = Callable[[int], Sequence[int]]


@dataclass(frozen=True)
class ChosenViews:
    """The views of a capture that are to be used, their photographs still in their files."""

    file: CameraFile  # the chosen views alone
    paths: tuple[str, ...]  # of their photographs in the capture
    photographs: Photographs
    indices: tuple[int, ...]  # the views' places in the file
    selection: dict[str, Any]  # plain JSON values: by what they were chosen, of how many
    warnings: tuple[Notice, ...] = ()

    def read(self, place: int) -> bytes:
        """The encoded photograph of a chosen view."""
        return self.photographs.read(self.paths[place])


class Capture:
    """Cameras, and files among which their photographs are."""

    def __init__(self, files: Files, base: str, table: CameraTable, *, max_pixels: int = MAX_PIXELS) -> None:
        beside = table.source.rpartition("/")[0]
        self.files = files
        self.table = table
        self._photographs = Photographs(files, base, beside, table.names, max_pixels)
        self._paths: list[str] | None = None  # where the file names none

    @classmethod
    def of(cls, files: Files, *, max_pixels: int = MAX_PIXELS, max_camera_bytes: int = MAX_CAMERA_BYTES) -> Capture:
        """Recognised by content. Raises `CaptureError` and `CameraError`."""
        return cls(files, *recognised(files, max_camera_bytes), max_pixels=max_pixels)

    @property
    def names(self) -> tuple[str | None, ...]:
        """Of the views' photographs: the file's, else those of the photographs that belong to them by order. Raises
        `CaptureError` where these are not as many."""
        return tuple(self._in_order()) if self.table.by_sorted_name else self.table.names

    def cameras(self, indices: Sequence[int]) -> CameraFile:
        """The cameras of these views, as they are in the file; photographs are read where it lacks their sizes."""
        return self.table.parse(indices, self._size_of)

    @cached_property
    def by_sorted_name(self) -> bool:
        """Whether view i belongs to photograph i of all that there are, sorted by name: where the file has no names,
        and where its names are time stamps and no photograph has that of another view than order gives it to."""
        if self.table.by_sorted_name or self.table.kind != "realestate10k":
            return self.table.by_sorted_name
        named = {index: path for index in range(len(self.table.names)) if (path := self._named(index))}
        if len(named) in (0, len(self.table.names)):
            return not named
        try:
            return all(self._in_order()[index] == path for index, path in named.items())
        except CaptureError:  # not as many photographs as views
            return False

    def path_of(self, index: int) -> str:
        """Where the photograph of a view is. Raises `ImageError` where it is not there."""
        if self.by_sorted_name:
            return self._in_order()[index]
        return self._photographs.find(self.table.names[index], index)

    def _named(self, index: int) -> str | None:
        """The photograph that has the name of this view."""
        try:
            return self._photographs.find(self.table.names[index], index)
        except ImageError:
            return None

    def choose(self, wish: Wish, near: float | None = None, far: float | None = None) -> ChosenViews:
        """The views that are wished for; `near` and `far` are the user's, which win over the file's.

        Without a wish all of a capture of up to six. Of more, those are chosen from that have a photograph and a camera
        that can be used; a warning tells of the others' cameras. Raises `ViewError`, `ImageError`, `CameraError` and
        `CaptureError`.
        """
        count = len(self.table.names)
        said: dict[str, Any] = {"format": self.table.kind, "cameras": self.table.source, "of": count}
        if wish.select is not None:
            indices = several_named_views(wish.select, self.names, field=wish.field, path_of=self._found)
            return self._chosen(self.cameras(indices), indices, {"by": "select", **said})
        if wish.context is None and count <= MAX_VIEWS:
            indices = list(range(count))
            return self._chosen(self.cameras(indices), indices, {"by": "all", **said})
        there = self._with_photograph()
        said["without_photograph"] = count - len(there)
        if wish.context is None and len(there) <= MAX_VIEWS:
            return self._chosen(self.cameras(there), there, {"by": "photographs", **said})
        there, file, warnings = usable_views(there, self.cameras)
        near, far = (file.near if near is None else near), (file.far if far is None else far)
        choice = chosen_views(file.cameras, wish.context or DEFAULT_CONTEXT, near, far)
        indices = [there[place] for place in choice.places]
        return self._chosen(file.chosen(choice.places), indices, {"by": "score", **said, **choice.said}, warnings)

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

    def _with_photograph(self) -> list[int]:
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

    def _in_order(self) -> list[str]:
        if self._paths is None:
            self._paths = self._photographs.in_order(len(self.table.names))
        return self._paths

    def _size_of(self, name: str | None, index: int) -> tuple[int, int]:
        return self._photographs.size_of(self.path_of(index), index)


def open_capture(path: str | Path) -> Capture:
    """A folder, a .zip or a camera file with its photographs beside it, by content and not by name.

    A zip stays open as long as the capture is used. Raises `CaptureError` and `CameraError`.
    """
    path = Path(path)
    if path.is_dir():
        return Capture.of(FolderFiles(path))
    if not path.is_file():
        raise CaptureError(f"{path} does not exist", field="capture", cure="give a folder, a .zip or a camera file")
    try:
        stream = path.open("rb")
    except OSError as error:
        cure = "ask who owns it for permission"
        raise CaptureError(f"{path} cannot be read: {error.strerror}", field="capture", cure=cure) from error
    if stream.read(4) in SIGNATURES:
        return Capture.of(ZipFiles(stream, str(path)))
    stream.close()
    root = _root_of(path)
    files = FolderFiles(root)
    return Capture(files, "", table_of_file(files, Path(os.path.relpath(path, root)).as_posix()))


def _root_of(path: Path) -> Path:
    """The folder among whose files the photographs of a named camera file are: its own. A COLMAP model that has no
    folder of photographs beside it stands for its project, the folder above `sparse`."""
    above = folders_below_project(Path(os.path.abspath(path.parent))) if is_of_colmap(path.name) else 0
    if not above or any((path.parent / name).is_dir() for name in FOLDERS if name):
        return path.parent
    return Path(os.path.abspath(path.parent)).parents[above - 1]


def read_camera_file(path: str | Path) -> CameraFile:
    """All cameras of a camera file, a folder or a .zip; its photographs are needed only where it leaves their sizes
    out. Raises `CameraError`, `CaptureError` and `ImageError`.
    """
    capture = open_capture(path)
    return capture.cameras(range(len(capture.table.names)))


@dataclass(frozen=True)
class SceneFolder:
    """A folder with a camera file and the photographs of its chosen views, one path per view."""

    file: CameraFile  # the chosen views alone
    image_paths: tuple[Path, ...]
    indices: tuple[int, ...]  # the chosen views' places in the file


def load_scene_folder(path: str | Path, choose: Choice | None = None) -> SceneFolder:
    """The views of a folder or a camera file whose photographs show what their pinholes see; found, not decoded.

    `choose` says which views are wanted: the others' photographs need not be there. Raises `CameraError` for a missing
    or malformed file, `IntrinsicsError` for a lens that bends, and `ImageError` for a photograph that is not there.
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
