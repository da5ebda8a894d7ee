"""Cameras from COLMAP models, with the depths of their points; camera models that are no pinholes and cannot be
undistorted are refused."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import PurePath

from ..cameras.camera_fields import CameraFile, SizeOf, view_through
from ..cameras.distortion import Lens
from ..cameras.pose import inverted_pose
from ..cameras.pose_cures import COLMAP
from ..errors import CameraError, IntrinsicsError
from . import colmap_binary, colmap_text
from .colmap_model import ColmapCamera, ColmapModel
from .colmap_points import depth_bounds
from .files import Files, joined
from .table import CameraTable, check_listed

# Parameters in the order of the file; `f` stands for fx and fy.
PARAMETERS = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
}
_READERS = {"bin": colmap_binary, "txt": colmap_text}
FORMS = tuple(_READERS)  # endings of a model's files
WHOLE = ("cameras", "images")  # files that each model has
_FILES = (*WHOLE, "rigs", "frames", "points3D")


def is_of_colmap(name: str) -> bool:
    """Whether a file of this name stands for the COLMAP model that it lies in."""
    stem, _, form = name.rpartition(".")
    return stem in _FILES and form in FORMS


def folders_below_project(folder: PurePath) -> int:
    """Depth of a model's folder in its project: 1 for sparse, 2 for sparse/1, one more below colmap; else 0."""
    names = list(folder.parts[::-1])
    place = names.index("sparse") if "sparse" in names[:2] else -1
    return place + 1 + (names[place + 1 : place + 2] == ["colmap"]) if place >= 0 else 0


def is_whole(files: Files, folder: str, form: str) -> bool:
    """Whether a folder has both cameras and images in this form, `bin` or `txt`."""
    return all(files.has(joined(folder, f"{name}.{form}")) for name in WHOLE)


def has_colmap(files: Files, folder: str) -> str | None:
    """The first of `bin` and `txt` in which the folder holds a whole model; None where it holds none."""
    return next((form for form in FORMS if is_whole(files, folder, form)), None)


def read_colmap(files: Files, folder: str, form: str) -> CameraTable:
    """The model in a folder, its images in the order of their names, with the bounds of `depth_bounds`. Raises
    `CameraError`."""
    model = _model(files, folder, form)
    source = joined(folder, f"images.{form}")
    check_listed(len(model.images), source)
    depths = depth_bounds(files, folder, form, model)
    ids = sorted(model.images, key=lambda image_id: (model.images[image_id].name, image_id))

    def parse(indices: Sequence[int], size_of: SizeOf | None) -> CameraFile:
        views = []
        for index in indices:
            image = model.images[ids[index]]
            camera = model.cameras.get(image.camera_id)
            if camera is None:
                message = f"{source}: {image.name!r} is of camera {image.camera_id}, which is missing"
                raise CameraError(message, field="cameras", index=index, cure="are both files of one model?")
            cam_from_world = model.pose(ids[index], index)
            pose = inverted_pose(cam_from_world, field="cameras", index=index).written(COLMAP, "opencv", "w2c")
            lens = lens_of(camera, image.camera_id, index)
            view = view_through(image.name, lens, pose, field="cameras", index=index)
            views.append(replace(view, bounds=depths.of.get(ids[index])))
        return CameraFile.bounded(views)

    names = tuple(model.images[image_id].name for image_id in ids)
    return CameraTable("colmap", source, names, parse, warnings=depths.warnings)


def lens_of(camera: ColmapCamera, camera_id: int, index: int) -> Lens:
    """The lens of a camera. Raises `IntrinsicsError` for an unsupported camera model."""
    names = PARAMETERS.get(camera.model)
    if names is None:
        raise IntrinsicsError(
            f"camera {camera_id} is {camera.model}, need one of {', '.join(PARAMETERS)}",
            field="cameras.model",
            index=index,
            cure="undistort the photographs first, for example with colmap image_undistorter",
        )
    values = dict(zip(names, camera.params, strict=True))
    if "f" in values:
        values["fx"] = values["fy"] = values.pop("f")
    return Lens(camera.width, camera.height, **values)


def _model(files: Files, folder: str, form: str) -> ColmapModel:
    """Read a model without its points; rigs and frames only if both files exist."""
    reader = _READERS[form]
    paths = {name: joined(folder, f"{name}.{form}") for name in ("cameras", "images", "rigs", "frames")}
    model = ColmapModel()
    with files.open(paths["cameras"]) as stream:
        model.cameras = reader.read_cameras(stream, paths["cameras"])
    with files.open(paths["images"]) as stream:
        model.images = reader.read_images(stream, paths["images"])
    if files.has(paths["rigs"]) and files.has(paths["frames"]):
        with files.open(paths["rigs"]) as stream:
            model.rigs = reader.read_rigs(stream, paths["rigs"])
        with files.open(paths["frames"]) as stream:
            model.frames = reader.read_frames(stream, paths["frames"])
    return model
