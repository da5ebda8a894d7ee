"""Posed photographs in, 3D Gaussians in the caller's world out: checks, fitting, the network, and the way back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .arguments import listed, whole_numbers
from .cameras.camera import Camera
from .cameras.depth_range import DepthRange, depth_range
from .cameras.leave_one_out import DEFAULT_OTHERS, nearest_others, not_foretold
from .cameras.pose_notices import pose_notices
from .cameras.view_checks import MIN_VIEWS, Notice, check_count, check_views
from .cameras.world_frame import WorldFrame
from .document import scene_document
from .errors import CameraError, InputError, ViewCountError
from .formats.ply_write import Positions, stored_positions
from .gaussians import Gaussians
from .inputs import prepared_inputs
from .kernels import is_warm, warm_up
from .leaving_out.budget import Budget
from .leaving_out.left_out import leave_out, table
from .mending.after_network import MOVED, Unpruned, at_finer_depths, at_mended_depths, mended, placed
from .mending.detail import finer
from .mending.detail_level import DETAILS
from .mending.fade_passes import DEFAULT_PASSES
from .mending.finer_grid import unsqueezed
from .network.backends.choice import DEFAULT_ENGINE, EngineName
from .network.engine import Arrays, Engine
from .options import checked_options
from .photographs.fitting import FittedPhotos, Picture
from .photographs.images import FittedView, PackedView
from .photographs.masks import patch_mask
from .photographs.whole import squeezed
from .process.allocator import freed_blocks_reused
from .process.compiler_pages import leave_compiler
from .progress import Listener, Stages, silent
from .self_check import ambiguous_routes, drawn_again, from_others, self_check
from .splat import Render, render
from .viewpoints.scene_views import SceneViews

FINEST = max(DETAILS)  # times the network's pixels, each way


@dataclass(frozen=True, eq=False)
class Scene:
    """A reconstruction: the Gaussians in the caller's world and units, and everything that is known about them."""

    gaussians: Gaussians
    cameras: tuple[Camera, ...]  # as given
    view_cameras: tuple[Camera, ...]  # of the photographs on the scene's grid
    inputs: tuple[NDArray[np.uint8], ...]  # those pictures, (H, W, 3) or, where a mask leaves pixels out, (H, W, 4)
    document: dict[str, Any]  # plain JSON values, see document.py

    def __repr__(self) -> str:
        return f"<Scene of {len(self.gaussians)} Gaussians from {len(self.cameras)} photographs>"

    @property
    def positions(self) -> Positions:
        """As what a .ply holds x, y, z of these Gaussians to the bit."""
        return stored_positions(self.gaussians)

    def render(self, camera: Camera, **options: Any) -> Render:
        """The picture that `camera` has of the scene, drawn as the service does, from a tenth of its near depth on: in
        the caller's units, and as the bound on what was left out has it. `options` as for the function; a `definition`
        and a `compatibility` have near planes of their own."""
        own = {"near", "definition", "compatibility"} & {name for name, value in options.items() if value is not None}
        near = {} if own else SceneViews.of_document(self.document).near_plane
        return render(self.gaussians, camera, **{**options, **near})


class Reconstructor:
    """Holds the loaded network; `reconstruct` may be called any number of times, also from several threads."""

    def __init__(
        self,
        model: str | Path | Engine | None = None,
        *,
        threads: int | None = None,
        prepare: str | Path | None = None,
        engine: EngineName = DEFAULT_ENGINE,
    ) -> None:
        """`model`: an ONNX file, a loaded one, or None for the one in the package; `prepare` and `engine` as for
        `Engine`. Raises `ModelError`."""
        self.engine = (
            model if isinstance(model, Engine) else Engine(model, threads=threads, prepare=prepare, engine=engine)
        )

    def reconstruct(
        self,
        images: Sequence[Picture],
        cameras: Sequence[Camera],
        *,
        near: float | None = None,
        far: float | None = None,
        trust_poses: bool = False,
        refine_poses: bool = False,
        budget: Budget | None = None,
        leave_one_out: int = DEFAULT_OTHERS,
        fade: int = DEFAULT_PASSES,
        detail: int = 1,
        whole: bool = True,
        numbers: Sequence[int] | None = None,
        listener: Listener = silent,
    ) -> Scene:
        """Reconstruct a `Scene` from 2 to 6 photographs with one camera each.

        `images`: uint8 arrays (H, W, 3) or (H, W, 4) with a mask as alpha, paths, bytes of files, PIL images, `Photo`
        or `EncodedPhoto`. Files are decoded one at a time and dropped once fitted; a photograph with a lens is
        undistorted to its camera, the pinhole of `pinhole_window`. Exposures are equalised (`exposures.py`), also in
        the scene's `inputs`; rolled photographs are turned to stand alike (`rolled.py`), but not in these.

        `near`, `far`: z-depths in the cameras' units; by default estimated from the cameras and narrowed to where the
        photographs match. A given range is only narrowed where it is far too wide.
        `trust_poses`: only warn where the photographs contradict the poses, or views do not overlap.
        `refine_poses`: where poses or focal lengths are slightly wrong, all cameras but one are corrected to match
        (`refined_poses.py`), a warning tells by how much, and `view_cameras` has them.
        `budget`: what may be left out of the scene, and for which views the error is bounded; None is `Budget()`.
        `leave_one_out`: of three photographs or more, each is compared with its render from a reconstruction of this
        many others, 2 or more, the nearest with parallax among themselves (a warning where none have); 0: not done.
        `fade`: passes that fit opacities and colours to the photographs (`fading.py`), after depths were refined and a
        backdrop was added (`after_network.py`); with 0 all of this is skipped, and the scene is the network's own.
        `detail`: 1, or 2 for four Gaussians per pixel, in the colours of photographs with twice the pixels each way
        (`detail.py`).
        `whole`: photographs of another aspect than the network's are used as a whole (`whole.py`); False crops them.
        `numbers`: what errors and warnings call the views, one each; by default 0, 1, 2...
        `listener`: hears the stages cameras, images, network, kernels (the first time), refine, detail, gaussians,
        fade, leave out, check and leave one out.

        Raises `InputError` and `ModelError`.
        """
        stages = Stages(listener)
        engine = self.engine
        warnings: list[Notice] = []
        trust_poses, refine_poses, budget, leave_one_out, fade, detail, whole = checked_options(
            trust_poses=trust_poses,
            refine_poses=refine_poses,
            budget=budget,
            leave_one_out=leave_one_out,
            fade=fade,
            detail=detail,
            whole=whole,
        )
        with stages.stage("cameras"):
            images, cameras = listed(images, "images"), listed(cameras, "cameras")
            numbers = range(len(images)) if numbers is None else whole_numbers(numbers, "numbers")
            cameras = _as_cameras(cameras, numbers, len(images))
            depths = depth_range(cameras, near, far)
            for view in budget.asked:  # a wrong one is refused here, before the network runs
                SceneViews(cameras, depths.near, depths.far).resolve(view, field="budget.asked")
            warnings += check_views(cameras, depths, trust_poses=trust_poses, numbers=numbers)
            warnings += pose_notices(cameras, depths.near, numbers)
        with stages.stage("images", len(images) + 1) as done, freed_blocks_reused():
            inputs = prepared_inputs(
                images,
                cameras,
                numbers,
                depths,
                engine.info,
                detail=detail,
                finer=FINEST if fade or detail > 1 else 1,
                trust_poses=trust_poses,
                refine_poses=refine_poses,
                whole=whole,
                done=done,
            )
            warnings += inputs.warnings
        depths, photos, turned = inputs.depths, inputs.photos, inputs.turned
        view_cameras = tuple(view.camera for view in photos.shown)
        scene = SceneViews(view_cameras, depths.near, depths.far)
        found = self._mended(turned, depths, scene, fade=fade, detail=detail, stride=budget.stride, stages=stages)
        with stages.stage("leave out"):
            lean, drawn, pruned = leave_out(found.gaussians, found.of_pixel, scene, budget, engine.threads)
        with stages.stage("check"), freed_blocks_reused():
            own, options = found.placed, {"threads": engine.threads, **scene.near_plane}
            check = {
                **self_check(photos.seen, depths, engine.info, drawn, photos.shown),
                "from_others": from_others(own.gaussians, own.owner, turned.shown, **options),
                "leave_one_out": None,
                "ambiguous_routes": ambiguous_routes(found.outputs, found.patch_mask),
            }
        if leave_one_out and len(cameras) > MIN_VIEWS:
            with stages.stage("leave one out", len(cameras)) as done:
                chosen = [nearest_others(cameras, i, leave_one_out, depths.near) for i in range(len(cameras))]
                alone = [i for i, others in enumerate(chosen) if not others]
                warnings += [not_foretold(cameras, i, depths.near, numbers[i]) for i in alone]
                check["leave_one_out"] = self._left_one_out(turned, depths, scene, chosen, fade, done)
        document = scene_document(
            engine=engine,
            cameras=cameras,
            detail=detail,
            inputs=inputs,
            unpruned=found,
            gaussians=lean,
            left_out=table(found, engine.info, pruned),
            pruned=pruned,
            check=check,
            warnings=warnings,
            timings=stages.timings,
        )
        return Scene(lean, cameras, view_cameras, tuple(view.pixels() for view in photos.shown), document)

    def run_network(
        self, views: Sequence[FittedView], depths: DepthRange
    ) -> tuple[Arrays, WorldFrame, NDArray[np.bool_]]:
        """The network's outputs on the grid of `views`, whatever their shape; the frame that they are in; and the mask
        (V, P) of its patches, those in which `views` have a kept pixel."""
        info = self.engine.info
        given = [squeezed(view, *info.shape) for view in views]
        cameras = [view.camera for view in given]
        frame, masks = WorldFrame.of(cameras, depths), patch_mask(views, *info.patch_shape)
        outputs = self.engine.run(
            np.stack([view.image for view in given]),
            np.stack([camera.normalized_intrinsics for camera in cameras]).astype(np.float32),
            frame.poses(cameras),
            frame.near_far(depths),
            masks,
        )
        return unsqueezed(outputs, frame, given, views), frame, masks

    def _mended(
        self,
        photos: FittedPhotos,
        depths: DepthRange,
        scene: SceneViews,
        *,
        fade: int,
        detail: int = 1,
        stride: int = 1,
        stages: Stages,
    ) -> Unpruned:
        """From `photos` to Gaussians after `fade` passes. `scene` has the near plane of all pictures."""
        seen, views, threads = photos.seen, photos.shown, self.engine.threads
        if not is_warm():
            leave_compiler()  # it comes with the import of the loops
        with stages.stage("network"):
            outputs, frame, masks = self.run_network(seen, depths)
        if not is_warm():  # not before the network: they would be in memory beside it
            with stages.stage("kernels"):  # compiled the first time, then loaded
                warm_up()
        if fade:
            with stages.stage("refine"):
                outputs = at_mended_depths(outputs, frame, seen, depths.far, threads)
        if detail > 1:
            with stages.stage("detail"):
                outputs = finer(outputs, frame, seen, views)
                if fade:
                    outputs = at_finer_depths(outputs, frame, views, depths.far)
        with stages.stage("gaussians"):
            found = placed(outputs, frame, views, stride=stride, moved=fade > 0, coarse=seen)
            outputs = {name: value for name, value in outputs.items() if name not in MOVED}
        with stages.stage("fade", fade + 1) as done:
            resized = [PackedView.of(view) for view in seen] if detail > 1 else photos.fine
            fading = mended(found, views, scene, fade, threads, done, resized=resized)
        return Unpruned(outputs, masks, found, fading)

    def _left_one_out(
        self,
        photos: FittedPhotos,
        depths: DepthRange,
        scene: SceneViews,
        chosen: Sequence[Sequence[int]],
        fade: int,
        done: Callable[[int], None],
    ) -> list[dict[str, Any]]:
        """Each view drawn from a reconstruction of the `chosen` others, null figures where these are none."""
        rows: list[dict[str, Any]] = []
        for index, view in enumerate(photos.seen):
            row: dict[str, Any] = dict.fromkeys(("psnr", "ssim", "holes"))
            if chosen[index]:
                others = photos.without_detail(chosen[index])
                found = self._mended(others, depths, scene, fade=fade, stages=Stages())
                options: dict[str, Any] = {"threads": self.engine.threads, **scene.near_plane}
                row = drawn_again(render(found.gaussians, view.camera, outputs=("alpha",), **options), view)
            rows.append({"from": list(chosen[index]), **row})
            done(index + 1)
        return rows


def _as_cameras(cameras: Sequence[Camera], numbers: Sequence[int], images: int) -> tuple[Camera, ...]:
    if len(numbers) != images:
        raise InputError(f"{images} images and {len(numbers)} numbers, need one per image", field="numbers")
    if len(cameras) != images:
        raise ViewCountError(f"{images} images and {len(cameras)} cameras, need one camera per image", field="cameras")
    check_count(images)
    for index, camera in zip(numbers, cameras, strict=True):
        if not isinstance(camera, Camera):
            raise CameraError(f"is a {type(camera).__name__}", field="cameras", index=index, cure="use Camera.make")
    return tuple(cameras)
