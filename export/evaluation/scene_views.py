"""The inputs and held-out targets of a capture: those that it suggests, else those that a rule holds out."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.view_checks import Notice
from gapmes.service.captures.capture import Capture, ChosenViews, open_capture
from gapmes.service.captures.files import FolderFiles
from gapmes.service.captures.usable import usable_views
from gapmes.service.errors import CaptureError, ImageError, InputError
from gapmes.service.photographs.images import Photo, decode_image, match_photo
from gapmes.service.photographs.undistort import undistorted
from gapmes.service.plain_number import counted

from .held_out import held_out_views
from .suggested import NoSuchViews, check_indices, suggested_by, suggested_views, suggestions

SUGGESTED, HELD_OUT = "suggested", "held out"


@dataclass(frozen=True)
class Photographs:
    """Which photographs of a capture are compared."""

    by: str  # SUGGESTED or HELD_OUT
    inputs: tuple[str, ...]  # paths in the capture
    targets: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class SceneViews:
    """The chosen views of a capture; photographs are not read yet."""

    path: Path  # of the capture
    capture: Capture
    by: str  # SUGGESTED or HELD_OUT
    inputs: ChosenViews
    targets: ChosenViews
    warnings: tuple[Notice, ...]  # about the capture

    @property
    def said(self) -> Photographs:
        return Photographs(self.by, self.inputs.paths, self.targets.paths)

    @property
    def root(self) -> Path:
        """Where the paths in the capture begin: a folder, or a zip."""
        return self.capture.files.root if isinstance(self.capture.files, FolderFiles) else self.path

    @property
    def camera_file(self) -> Path:
        """The file that its cameras are read from, however the capture was named."""
        return (self.root / self.capture.table.source).resolve()

    def spare(self) -> list[int]:
        """Indices of the views with a photograph and a usable camera that are neither inputs nor targets."""
        used = {*self.inputs.indices, *self.targets.indices}
        there, *_ = usable_views(self.capture.with_photograph(), self.capture.cameras)
        return [index for index in there if index not in used]

    def photograph(self, views: ChosenViews, place: int) -> tuple[Photo, Camera]:
        """A photograph of `views` of this capture at its own size, without lens distortion, with its camera. Raises
        `ImageError` where it cannot be decoded or has transparent pixels, naming the file."""
        index, view = views.indices[place], views.file.views[place]
        file = self.root / views.paths[place]
        try:
            photo = decode_image(views.read(place), index=index)
        except (ImageError, CaptureError) as error:  # of one scene of several
            named = f"{file}: {error.message}"
            raise type(error)(named, field=error.field, index=index, cure=error.cure, **error.extra) from error
        if photo.mask is not None:
            raise ImageError(
                f"{file} is transparent in {(~photo.mask).sum()} of {photo.mask.size} pixels, need 0: all are compared",
                field="images",
                index=index,
                cure="save the scene's photographs without an alpha channel, or leave the scene out",
            )
        if view.lens is None:
            return match_photo(photo, view.camera, index=index)
        photo = undistorted(photo, view.lens, index=index)
        return photo, view.camera.resized(photo.width, photo.height)


def scene_views(path: Path, inputs: int) -> SceneViews:
    """The views of a scene folder that its `cameras.json` suggests for a number of inputs; of any other capture those
    that `held_out_views` chooses.

    Raises `NoSuchViews` where there are none, and `InputError` for what is no capture, for a wrong suggestion, and for
    inputs whose cameras or depths a reconstruction would refuse; each names the capture.
    """
    try:
        if (suggested := suggestions(path)) is not None:
            suggested_views(path, suggested, inputs)  # told before the cameras are read
        capture = open_capture(path)
        if suggested is None and (suggested := suggested_by(capture, path)) is None:
            return _checked(_held_out(path, capture, inputs))
        context, targets = suggested_views(path, suggested, inputs)
        check_indices(path, inputs, (context, targets), len(capture.table.names))
        given, held_out = capture.views(context), capture.views(targets)
        return _checked(SceneViews(path, capture, SUGGESTED, given, held_out, given.warnings))
    except InputError as error:  # of one capture of several
        if not error.message.startswith(str(path)):
            error.message = f"{path}: {error.message}"
        raise


def _held_out(path: Path, capture: Capture, inputs: int) -> SceneViews:
    """Raises `NoSuchViews` where there are no targets."""
    there, file, warnings = usable_views(capture.with_photograph(), capture.cameras)
    given, held_out = held_out_views(file.cameras, file.middles(None, None), inputs)
    if not held_out:
        raise NoSuchViews(
            f"{path} has {counted(len(there), 'view')} with a photograph; with every second one held out, no target is "
            f"left that {inputs} inputs see and that lies between them",
            field="SCENE_DIR",
            cure='take more photographs between those that are there, or name views in a cameras.json: "suggested": '
            f'{{"context{inputs}": [...], "target{inputs}": [...]}}',
        )
    chosen, targets = (capture.views([there[place] for place in places]) for places in (given, held_out))
    return SceneViews(path, capture, HELD_OUT, chosen, targets, (*chosen.warnings, *warnings))


def _checked(views: SceneViews) -> SceneViews:
    """Raises `ImageError` where a target has the photograph of an input, or a file that equals it to the byte, and as
    `ChosenViews.checked_depths`."""
    views.inputs.checked_depths(None, None)
    inputs = {_digest(views.inputs, place): place for place in range(len(views.inputs.paths))}
    for place, (path, index) in enumerate(zip(views.targets.paths, views.targets.indices, strict=True)):
        if (same := inputs.get(_digest(views.targets, place))) is not None:
            raise ImageError(
                f"{path} is the photograph of view {views.inputs.indices[same]}, an input, too",
                field="views.image",
                index=index,
                cure="a target is held out: name one photograph for each view",
            )
    return views


def _digest(views: ChosenViews, place: int) -> bytes:
    return hashlib.sha256(views.read(place)).digest()
