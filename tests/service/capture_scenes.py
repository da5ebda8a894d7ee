"""One synthetic scene in every format that is read: folders with photographs, and the same folders as zips."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pycolmap
from PIL import Image

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.camera_file import camera_document
from gapmes.service.cameras.rotations import about_axis

WIDTH, HEIGHT, FOCAL = 96, 72, 80.0
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


def arc(count: int, width: int = WIDTH, height: int = HEIGHT, focal: float = FOCAL) -> list[Camera]:
    """Cameras 8 degrees apart around a point 4 units ahead; principal point in the middle, square pixels."""
    cameras = []
    for index in range(count):
        turn = about_axis(np.array([0.0, 1.0, 0.0]), np.radians(8.0) * (index - (count - 1) / 2))
        pose = np.eye(4)
        pose[:3, :3] = turn
        pose[:3, 3] = turn @ [0.0, 0.1 * (index % 2), -4.0] + [0.3, -0.2, 4.5]
        cameras.append(Camera.make(width, height, focal, focal, width / 2, height / 2, pose))
    return cameras


def photograph(seed: int, width: int = WIDTH, height: int = HEIGHT) -> bytes:
    blocks = np.random.default_rng(seed).integers(0, 256, (height // 8 + 1, width // 8 + 1, 3), dtype=np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(blocks.repeat(8, 0).repeat(8, 1)[:height, :width]).save(buffer, "PNG")
    return buffer.getvalue()


def names(count: int) -> list[str]:
    """Names with a space and a folder, as users have them."""
    return [f"left side/view {index:04d}.png" for index in range(count)]


def write_photographs(folder: Path, named: Sequence[str]) -> None:
    for seed, name in enumerate(named):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(photograph(seed))


def write_cameras_json(root: Path, cameras: Sequence[Camera]) -> None:
    named = [f"images/{name}" for name in names(len(cameras))]
    write_photographs(root, named)
    views = [camera_document(camera, name) for camera, name in zip(cameras, named, strict=True)]
    (root / "cameras.json").write_text(json.dumps({"views": views}))


def write_transforms(root: Path, cameras: Sequence[Camera], name: str = "transforms.json") -> None:
    """Write transforms.json as nerfstudio does."""
    named = [f"images/{each}" for each in names(len(cameras))]
    write_photographs(root, named)
    frames = [
        {"file_path": each, "transform_matrix": (camera.world_from_cam @ FLIP).tolist()}
        for camera, each in zip(cameras, named, strict=True)
    ]
    one = cameras[0]
    top = {"w": one.width, "h": one.height, "fl_x": one.fx, "fl_y": one.fy, "cx": one.cx, "cy": one.cy}
    (root / name).write_text(json.dumps(top | {"camera_model": "OPENCV", "k1": 0.0, "frames": frames}))


def write_blender(root: Path, cameras: Sequence[Camera]) -> None:
    """Write transforms.json as Blender's scripts do: a field of view, names without suffix, no sizes."""
    write_photographs(root, [f"train/r_{index}.png" for index in range(len(cameras))])
    frames = [
        {"file_path": f"./train/r_{index}", "transform_matrix": (camera.world_from_cam @ FLIP).tolist()}
        for index, camera in enumerate(cameras)
    ]
    angle = 2 * np.arctan(0.5 * cameras[0].width / cameras[0].fx)
    (root / "transforms_train.json").write_text(json.dumps({"camera_angle_x": float(angle), "frames": frames}))


def colmap_model(
    cameras: Sequence[Camera], named: Sequence[str], features: int | None = None
) -> pycolmap.Reconstruction:
    """A model with a camera per image, ids with gaps, not in the order of the names; each image has `features`, or 0
    to 2 of them."""
    model = pycolmap.Reconstruction()
    for index, (camera, name) in enumerate(zip(cameras, named, strict=True)):
        camera_id = 3 * index + 5
        params = [camera.fx, camera.fy, camera.cx, camera.cy]
        size = {"width": camera.width, "height": camera.height}
        model.add_camera_with_trivial_rig(pycolmap.Camera(camera_id=camera_id, model="PINHOLE", params=params, **size))
        image = pycolmap.Image(name=name, camera_id=camera_id, image_id=7 * (len(cameras) - index) + 3)
        many = index % 3 if features is None else features
        image.points2D = pycolmap.Point2DList([pycolmap.Point2D(np.array([index + 0.5, 2.0]))] * many)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(camera.cam_from_world[:3]))
    return model


def write_colmap(root: Path, cameras: Sequence[Camera], folder: str = "sparse/0", *, text: bool = False) -> None:
    write_photographs(root / "images", names(len(cameras)))
    (root / folder).mkdir(parents=True)
    model = colmap_model(cameras, names(len(cameras)))
    (model.write_text if text else model.write_binary)(str(root / folder))


def llff_rows(cameras: Sequence[Camera]) -> np.ndarray:
    """(N, 17): columns down, right, backwards, centre, (height, width, focal), then bounds of 2 to 9 and more."""
    rows = []
    for index, camera in enumerate(cameras):
        right, down, ahead = camera.rotation.T
        lens = [camera.height, camera.width, camera.fx]
        matrix = np.stack([down, right, -ahead, camera.center, lens], axis=1)
        rows.append([*matrix.ravel(), 2.0 - 0.1 * index, 9.0 + index])
    return np.array(rows)


def write_llff(root: Path, cameras: Sequence[Camera]) -> None:
    write_photographs(root / "images", [f"IMG {index:03d}.png" for index in range(len(cameras))])
    np.save(root / "poses_bounds.npy", llff_rows(cameras))


def realestate10k_text(cameras: Sequence[Camera]) -> str:
    lines = ["https://example.org/watch?v=0"]
    for index, camera in enumerate(cameras):
        width, height = camera.width, camera.height
        lens = [camera.fx / width, camera.fy / height, camera.cx / width, camera.cy / height]
        numbers = [*lens, 0.0, 0.0, *camera.cam_from_world[:3].ravel().tolist()]
        lines.append(" ".join([str(1_000_000 + 33_366 * index), *map(repr, numbers)]))
    return "\n".join(lines) + "\n"


def write_realestate10k(root: Path, cameras: Sequence[Camera]) -> None:
    write_photographs(root / "images", [f"{1_000_000 + 33_366 * index}.png" for index in range(len(cameras))])
    (root / "clip.txt").write_text(realestate10k_text(cameras))


WRITERS = {
    "cameras.json": write_cameras_json,
    "transforms.json": write_transforms,
    "blender": write_blender,
    "colmap binary": write_colmap,
    "colmap text": lambda root, cameras: write_colmap(root, cameras, "colmap/sparse/0", text=True),
    "colmap beside": lambda root, cameras: write_colmap(root, cameras, "sparse"),
    "llff": write_llff,
    "realestate10k": write_realestate10k,
}


def zipped(folder: Path, *, inside: str = "") -> bytes:
    """A zip of the folder's files, below `inside`."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                archive.write(path, f"{inside}{path.relative_to(folder)}")
    return buffer.getvalue()
