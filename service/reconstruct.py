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
from .cameras.foretold import DEFAULT_OTHERS, checked_others, nearest_others, not_foretold
from .cameras.pose_notices import pose_notices
from .cameras.view_checks import DEPTH_PLANES, MIN_VIEWS, Notice, check_count, check_views, range_notices
from .cameras.world_frame import WorldFrame
from .document import scene_document
from .errors import CameraError, InputError, ViewCountError
from .formats.ply_write import Positions, stored_positions
from .gaussians import Gaussians
from .kernels import is_warm, warm_up
from .leaving_out.budget import Budget, checked_budget
from .leaving_out.left_out import leave_out, table
from .matching.depth_sweep import coarse_notices, narrowed
from .matching.exposures import equalised
from .matching.photo_checks import check_photos
from .mending.after_network import MOVED, at_finer_depths, at_mended_depths, mended, placed
from .mending.detail import finer
from .mending.detail_level import DETAILS, checked_detail
from .mending.fade_passes import DEFAULT_PASSES, checked_passes
from .network.backends.choice import DEFAULT_ENGINE, EngineName
from .network.engine import Arrays, Engine
from .photographs.fitting import Picture, fitted_photos
from .photographs.images import FittedView, PackedView
from .photographs.masks import FADED, patch_mask
from .photographs.rolled import quarter_turns, turned_photos
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
    view_cameras: tuple[Camera, ...]  # of the crops that the network saw, with `detail` times their pixels each way
    inputs: tuple[NDArray[np.uint8], ...]  # those crops, (H, W, 3) or, where a mask leaves pixels out, (H, W, 4)
    document: dict[str, Any]  # plain JSON values, see document.py

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
        prepare: Path | None = None,
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
        budget: Budget | None = None,
        leave_one_out: int = DEFAULT_OTHERS,
        fade: int = DEFAULT_PASSES,
        detail: int = 1,
        numbers: Sequence[int] | None = None,
        listener: Listener = silent,
    ) -> Scene:
        """2..6 photographs, uint8 (H, W, 3 or 4), path, a file's bytes, PIL image, `Photo` or `EncodedPhoto`, with one
        camera each -> `Scene`.

        One in a file is decoded in its turn and dropped once it is fitted: one at a time is in memory; one with a
        lens is resampled to its camera, which is the pinhole that `pinhole_window` names.
        `near` and `far` are z-depths in the cameras' units, estimated from cameras and photographs without them, and
        narrowed by the photographs where they are far too wide.
        Photographs of different exposure are brought to one (`exposures.py`), and the scene's `inputs` with them;
        rolled ones are turned for the network (`rolled.py`), and nowhere else.
        `trust_poses` turns the refusal of poses that the photographs contradict, and of views that do not overlap, into
        a warning. `budget` says what may be left out of the scene and for which views that is proved; `Budget()`
        does without one. With three photographs or
        more each is also compared with its picture from a reconstruction of the `leave_one_out` others
        that are nearest to it (2 or more; all others where there are fewer; 0: not done) and have parallax among
        themselves; where none have, a warning says so. `fade` is how
        often opacities are lowered and colours corrected where the photographs contradict them (`fading.py`), after
        depths have moved to where the photographs match best and a backdrop stands behind them (`mending.py`); with 0
        all stays as the network gave it. With `detail` 2 four Gaussians take the place of each pixel's one, in the
        colours of photographs of twice the network's size (`detail.py`): a scene for larger pictures.
        `numbers` are what errors and warnings call the views, one for each, where these were chosen from more; else
        they are counted from 0.
        `listener` hears the stages cameras, images, network, kernels (the first time), refine, detail, gaussians,
        fade, leave out, check, leave one out.
        Raises `InputError` and `ModelError`.
        """
        stages = Stages(listener)
        info = self.engine.info
        warnings: list[Notice] = []
        budget = checked_budget(budget)
        leave_one_out, fade = checked_others(leave_one_out), checked_passes(fade)
        detail = checked_detail(detail, budget.stride)
        with stages.stage("cameras"):
            images, cameras = listed(images, "images"), listed(cameras, "cameras")
            numbers = range(len(images)) if numbers is None else whole_numbers(numbers, "numbers")
            cameras = _as_cameras(cameras, numbers, len(images))
            depths = depth_range(cameras, near, far)
            planes = info.depth_planes or DEPTH_PLANES
            warnings += check_views(cameras, depths, trust_poses=trust_poses, numbers=numbers)
            warnings += pose_notices(cameras, depths.near, numbers)
        with stages.stage("images", len(images) + 1) as done, freed_blocks_reused():
            finest = FINEST if fade or detail > 1 else 1
            given = fitted_photos(images, cameras, numbers, info, detail, finer=finest, done=done)
            warnings += given.notices
            warnings += check_photos(given.seen, depths, trust_poses=trust_poses, numbers=numbers)
            asked, depths = depths, narrowed(depths, given.seen, planes)
            warnings += range_notices(depths, planes) + coarse_notices(asked, depths, given.seen, planes)
            given, told = equalised(given, depths, numbers)
            warnings += told
            turns = quarter_turns(cameras, square=info.height == info.width)
            photos, given = given, turned_photos(given, turns)
            seen, views, fine = given.seen, given.shown, given.fine
        masks = patch_mask(seen, info.patch)
        if not is_warm():
            leave_compiler()  # it comes with the import of the loops
        with stages.stage("network"):
            outputs, frame = self.run_network(seen, depths)
        if not is_warm():  # not before the network: they would be in memory beside it
            with stages.stage("kernels"):  # compiled the first time, then loaded
                warm_up()
        if fade:
            with stages.stage("refine"):
                outputs = at_mended_depths(outputs, frame, seen, depths.far, self.engine.threads)
        if detail > 1:
            with stages.stage("detail"):
                outputs = finer(outputs, frame, seen, views)
                if fade:
                    outputs = at_finer_depths(outputs, frame, views, depths.far)
        with stages.stage("gaussians"):
            found = placed(outputs, frame, views, stride=budget.stride, moved=fade > 0, coarse=seen)
            outputs = {name: value for name, value in outputs.items() if name not in MOVED}
        view_cameras = tuple(view.camera for view in photos.shown)
        scene = SceneViews(view_cameras, depths.near, depths.far)
        with stages.stage("fade", fade + 1) as done:
            resized = [PackedView.of(view) for view in seen] if detail > 1 else fine
            fading = mended(found, views, scene, fade, self.engine.threads, done, resized=resized)
        dropped = {**found.dropped, FADED: int(fading.gone.sum())} if fading.gone.any() else found.dropped
        gaussians = fading.gaussians[~fading.gone]
        with stages.stage("leave out"):
            may_go = found.of_pixel[~fading.gone]
            lean, drawn, pruned = leave_out(gaussians, may_go, scene, budget, self.engine.threads)
        with stages.stage("check"), freed_blocks_reused():
            check = {
                **self_check(photos.seen, depths, info, drawn, photos.shown),
                "from_others": from_others(
                    found.gaussians, found.owner, views, threads=self.engine.threads, **scene.near_plane
                ),
                "leave_one_out": None,
                "ambiguous_routes": ambiguous_routes(outputs, masks),
            }
        if leave_one_out and len(views) > MIN_VIEWS:
            with stages.stage("leave one out", len(views)) as done:
                near, every = depths.near, range(len(views))
                chosen = [nearest_others(cameras, index, leave_one_out, near) for index in every]
                warnings += [not_foretold(cameras, i, near, numbers[i]) for i in every if not chosen[i]]
                check["leave_one_out"] = self._foretold(seen, fine, depths, scene, chosen, fade, done)
        document = scene_document(
            info=info,
            made_by=self.engine.made_by,
            threads=self.engine.threads,
            cameras=cameras,
            detail=detail,
            views=photos.shown,
            turns=turns,
            depths=depths,
            outputs=outputs,
            gaussians=lean,
            added=found.added,
            dropped=dropped,
            left_out=table(outputs, masks, info, dropped, pruned, added=found.added),
            pruned=pruned,
            faded=fading.document(),
            check=check,
            warnings=warnings,
            timings=stages.timings,
        )
        return Scene(lean, cameras, view_cameras, tuple(view.pixels() for view in photos.shown), document)

    def run_network(self, views: Sequence[FittedView], depths: DepthRange) -> tuple[Arrays, WorldFrame]:
        """The network's outputs, and the frame that they are in."""
        cameras = [view.camera for view in views]
        frame = WorldFrame.of(cameras, depths)
        outputs = self.engine.run(
            np.stack([view.image for view in views]),
            np.stack([camera.normalized_intrinsics for camera in cameras]).astype(np.float32),
            frame.poses(cameras),
            frame.near_far(depths),
            patch_mask(views, self.engine.info.patch),
        )
        return outputs, frame

    def _foretold(
        self,
        views: Sequence[FittedView],
        fine: Sequence[PackedView],
        depths: DepthRange,
        scene: SceneViews,
        chosen: Sequence[Sequence[int]],
        fade: int,
        done: Callable[[int], None],
    ) -> list[dict[str, Any]]:
        """Each view drawn from a reconstruction of the `chosen` others, null figures where these are none; mended by
        the `fine` ones as well."""
        rows: list[dict[str, Any]] = []
        for index, view in enumerate(views):
            row: dict[str, Any] = dict.fromkeys(("psnr", "ssim", "holes"))
            if chosen[index]:
                others = [views[other] for other in chosen[index]]
                outputs, frame = self.run_network(others, depths)
                if fade:
                    outputs = at_mended_depths(outputs, frame, others, depths.far, self.engine.threads)
                found = placed(outputs, frame, others, moved=fade > 0)
                larger = [fine[other] for other in chosen[index]]
                gaussians = mended(found, others, scene, fade, self.engine.threads, resized=larger).gaussians
                options: dict[str, Any] = {"threads": self.engine.threads, **scene.near_plane}
                row = drawn_again(render(gaussians, view.camera, outputs=("alpha",), **options), view)
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
