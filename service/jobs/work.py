"""The inputs of one reconstruction, independent of HTTP: photographs, cameras, options; and computing it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from ..cameras.camera import Camera
from ..cameras.camera_file import camera_document
from ..cameras.distortion import Lens
from ..cameras.pose import Given
from ..cameras.view_checks import MIN_VIEWS
from ..formats.ply import ply_bytes
from ..leaving_out.budget import Budget
from ..mending.fade_passes import DEFAULT_PASSES
from ..model_names import DEFAULT
from ..photographs.image_files import check_total
from ..photographs.images import EncodedPhoto
from ..pictures.picture import png
from ..progress import Listener
from ..revision import ALGORITHM_REVISION
from ..scenes.store import SceneStore

if TYPE_CHECKING:
    from ..reconstruct import Reconstructor
    from ..settings import Settings


@dataclass(frozen=True)
class Work:
    """All inputs of a reconstruction; equal `scene_id` means equal scenes."""

    images: tuple[bytes, ...]  # encoded, as they were sent
    cameras: tuple[Camera, ...]
    near: float | None
    far: float | None
    trust_poses: bool
    leave_one_out: int
    budget: Budget
    model: str = DEFAULT  # the name that the service has for it
    fade: int = DEFAULT_PASSES
    detail: int = 1
    lenses: tuple[Lens | None, ...] = ()  # of photographs that are to be undistorted; empty if none is
    numbers: tuple[int, ...] = ()  # view numbers for errors and warnings; empty for 0, 1, ...
    refine_poses: bool = False

    def scene_id(self, identity: str) -> str:
        """Hash of everything that the stored scene depends on, and of nothing else: neither file names nor the model's
        name, nor the file that the poses come from, on which the words of a warning depend: those of a stored scene are
        for the file that made it. `identity` is that of the model's file and of the engine."""
        budget = self.budget
        bounded = budget.max_error is not None or budget.min_opacity > 0
        options: dict[str, Any] = {
            "near": self.near,
            "far": self.far,
            "trust_poses": self.trust_poses,
            "refine_poses": self.refine_poses,
            "max_error": budget.max_error,
            "certify": budget.certify if bounded else None,
            "views": budget.asked if bounded else None,
            "min_opacity": budget.min_opacity,
            "stride": budget.stride,
            "leave_one_out": min(self.leave_one_out, len(self.images) - 1) if len(self.images) > MIN_VIEWS else 0,
            "fade": self.fade,
            "detail": self.detail,
            "algorithm_revision": ALGORITHM_REVISION,
        }
        if self.lenses:
            options["lenses"] = [_lens_entry(lens) for lens in self.lenses]
        if self.numbers:
            options["numbers"] = self.numbers
        cameras = [{**camera_document(camera), "given": camera.given.precision} for camera in self.cameras]
        return SceneStore.scene_id(identity, self.images, cameras, options)

    def check_pixels(self, settings: Settings) -> None:
        """Check the limits on pixels by the photographs' headers. Raises `ImageError` and `ImageTooLarge`."""
        limits = {"max_pixels": settings.max_image_pixels, "max_total": settings.max_request_pixels}
        check_total(self.images, numbers=self.numbers or None, **limits)

    def document(self) -> dict[str, Any]:
        """All but the images as JSON values; `of_document` restores them exactly."""
        names = ("near", "far", "trust_poses", "refine_poses", "leave_one_out", "fade", "detail", "model")
        rest: dict[str, Any] = {name: getattr(self, name) for name in names}
        cameras, lenses = (
            [_camera_entry(camera) for camera in self.cameras],
            [_lens_entry(lens) for lens in self.lenses],
        )
        return {"cameras": cameras, "lenses": lenses, "numbers": self.numbers, "budget": asdict(self.budget), **rest}

    @classmethod
    def of_document(cls, document: Mapping[str, Any], images: Sequence[bytes]) -> Work:
        """Inverse of `document`; fields that an earlier release did not write have their defaults."""
        budget = {**document["budget"], "asked": tuple(document["budget"]["asked"])}
        cameras = tuple(_camera_of(entry) for entry in document["cameras"])
        lenses = tuple(None if entry is None else Lens(**entry) for entry in document.get("lenses", ()))
        numbers = tuple(document.get("numbers", ()))
        own = ("cameras", "lenses", "numbers", "budget")
        rest = {name: value for name, value in document.items() if name not in own}
        return cls(
            images=tuple(images), cameras=cameras, lenses=lenses, numbers=numbers, budget=Budget(**budget), **rest
        )


def compute(
    work: Work, scene_id: str, reconstructor: Reconstructor, store: SceneStore, settings: Settings, listener: Listener
) -> dict[str, Any]:
    """Decode, reconstruct and store; the scene is stored as a whole or not at all. Returns its document."""
    work.check_pixels(settings)
    scene = reconstructor.reconstruct(
        [
            EncodedPhoto(data, settings.max_image_pixels, lens)
            for data, lens in zip(work.images, work.lenses or (None,) * len(work.images), strict=True)
        ],
        work.cameras,
        near=work.near,
        far=work.far,
        trust_poses=work.trust_poses,
        refine_poses=work.refine_poses,
        budget=work.budget,
        leave_one_out=work.leave_one_out,
        fade=work.fade,
        detail=work.detail,
        numbers=work.numbers or None,
        listener=listener,
    )
    created = datetime.now(UTC).isoformat(timespec="seconds")
    document = {"id": scene_id, "created": created, **scene.document, "inputs": len(scene.inputs)}
    ply = ply_bytes(scene.gaussians, positions=scene.positions)
    store.put(scene_id, ply, document, [png(pixels) for pixels in scene.inputs])
    return document


def _camera_entry(camera: Camera) -> dict[str, Any]:
    return {**camera_document(camera), "given": list(camera.given)}


def _lens_entry(lens: Lens | None) -> dict[str, Any] | None:
    return None if lens is None else asdict(lens)


def _camera_of(entry: Mapping[str, Any]) -> Camera:
    """The camera of an entry of `document`, which was checked when it was submitted."""
    rest = {name: value for name, value in entry.items() if name not in ("c2w", "given")}
    return Camera(world_from_cam=np.array(entry["c2w"], dtype=np.float64), given=Given(*entry["given"]), **rest)
