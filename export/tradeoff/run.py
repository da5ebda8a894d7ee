"""The trade-off report: error and run time of network files, of pruning a scene, and of rendering settings."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from gapmes.model.training.lpips import Lpips
from gapmes.service.cameras.camera import Camera
from gapmes.service.errors import InputError
from gapmes.service.formats.ply import ply_bytes
from gapmes.service.gaussians import Gaussians
from gapmes.service.kernels import warm_up
from gapmes.service.leaving_out.budget import KEEP_ALL
from gapmes.service.leaving_out.pruning import BAND_NORMS, colour_range
from gapmes.service.mending.fade_passes import DEFAULT_PASSES
from gapmes.service.pictures.effort import draw
from gapmes.service.process.output_file import check_output_file
from gapmes.service.progress import Listener, Stages, silent
from gapmes.service.viewpoints.scene_views import NEAR_PLANE_SHARE

from ..evaluation.labels import given_twice, shortest_names
from . import files, knobs
from .child import Timed, timed
from .errors import cut_bound, drawn, model_error, network_rounding, setting_error, splatter_rounding
from .files import ModelFile
from .machine import this_machine
from .page import WRITTEN, write
from .scenes import Scene, load_scene
from .schema import Bound, Report, Row, SettingError, Timing

REPEATS = 7
PICTURE_REPEATS = 9
PICTURE_SCALE = 2  # pictures are timed at twice the network's size


def report(
    folders: Sequence[Path],
    out: Path,
    *,
    quick: bool = False,
    lpips: Path | None = None,
    threads: int | None = None,
    listener: Listener = silent,
) -> Report:
    """Measure on the scenes in `folders` and write report.json, its schema, report.md and pareto.png into `out`.

    Times are those of the first scene. `quick` leaves out the exports that take minutes, and all scenes but the first.
    Raises `InputError` for a folder that is no scene or suggests views that are not there, for one that is given twice
    and would count so in the means, and for files that cannot be written; `ChildFailed` where a process that exports or
    measures does.
    """
    started, stages = time.perf_counter(), Stages(listener)
    if (twice := given_twice(folders)) is not None:
        raise InputError(f"{twice} is given twice, or is the sample scene", field="scene")
    named = list(zip(folders, shortest_names(folders), strict=True))
    scenes = [load_scene(*scene) for scene in (named[:1] if quick else named)]
    out.mkdir(parents=True, exist_ok=True)
    for name in WRITTEN:
        check_output_file(out / name, field="report")
    weights = None if lpips is None else Lpips.load(lpips)
    with stages.stage("export files"):
        models = files.quick_files(out) if quick else files.all_files(out)
    with stages.stage("baseline"):
        warm_up()
        measure = _Measure(scenes, weights, threads)
    rows: list[Row] = []
    with stages.stage("network", len(models) + 1 + len(knobs.FADE_PASSES)) as done:
        for model in models:
            rows.append(measure.network(model))
            done(len(rows))
        rows += measure.views(models[0])
        done(len(models) + 1)
        for number, passes in enumerate(knobs.FADE_PASSES, len(models) + 2):
            rows.append(measure.fading(passes))
            done(number)
    with stages.stage("scene", len(knobs.SCENE_SETTINGS)) as done:
        for setting in knobs.SCENE_SETTINGS:
            rows.append(measure.scene(setting))
            done(sum(row.group == "scene" for row in rows))
    with stages.stage("picture", len(knobs.PICTURE_SETTINGS)) as done:
        for picture in knobs.PICTURE_SETTINGS:
            rows.append(measure.picture(picture))
            done(sum(row.group == "picture" for row in rows))
    result = Report(
        quick=quick,
        machine=this_machine(threads),
        scenes=[scene.name for scene in scenes],
        splatter_rounding=splatter_rounding(measure.whole.gaussians[0], scenes[0].targets[0].camera, measure.near(0)),
        rows=rows,
        seconds=round(time.perf_counter() - started, 1),
    )
    write(result, out)
    return result


class _Measure:
    """Measures rows against a baseline: unpruned scenes of the shipped network, and their pictures."""

    def __init__(self, scenes: Sequence[Scene], lpips: Lpips | None, threads: int | None) -> None:
        self.scenes, self.lpips, self.threads = scenes, lpips, threads
        self.given = [scene.given for scene in scenes]
        self.truth = [view for scene in scenes for view in scene.targets]
        self.whole = timed(None, self.given, KEEP_ALL, REPEATS, threads)
        self.exact = self._pictures(self.whole.gaussians)
        self.camera = scenes[0].targets[0].camera.resized(*(2 * [PICTURE_SCALE * scenes[0].targets[0].camera.width]))

    def near(self, index: int) -> float:
        """Where drawing begins."""
        return NEAR_PLANE_SHARE * float(self.whole.documents[index]["near"])

    def _pictures(self, sets: Sequence[Gaussians]) -> list[np.ndarray]:
        found = []
        for index, (scene, gaussians) in enumerate(zip(self.scenes, sets, strict=True)):
            found += drawn(gaussians, [view.camera for view in scene.targets], self.near(index))
        return found

    def network(self, file: ModelFile) -> Row:
        """A model file: time of a reconstruction, rounding (not of int8), change against the default file, quality."""
        plain = (file.knob, file.value) == ("precision", "fp32")
        run = self.whole if plain else timed(file.path, self.given, KEEP_ALL, REPEATS, self.threads)
        pictures = self.exact if plain else self._pictures(run.gaussians)
        same = file.size == files.ModelFile.size
        return _row(
            "network", file.knob, file.value, file.how, plain, _timing(run), run.peak_mb,
            megabytes=file.path.stat().st_size / 1e6,
            rounding=network_rounding(file, self.threads) if same and file.value != "int8" else None,
            setting=setting_error(pictures, self.exact) if same else None,
            model=model_error(pictures, self.truth, self.lpips),
        )  # fmt: skip

    def views(self, file: ModelFile) -> list[Row]:
        """More photographs of every scene, with the same targets; only where all scenes have that many."""
        rows = []
        for count in (2, 3, 4):
            if count > 2 and not all(count in scene.more for scene in self.scenes):
                continue
            given = self.given if count == 2 else [scene.more[count] for scene in self.scenes]
            run = self.whole if count == 2 else timed(file.path, given, KEEP_ALL, REPEATS, self.threads)
            quality = model_error(self._pictures(run.gaussians), self.truth, self.lpips)
            how = f"gapmes reconstruct --views, {count} of them" + (" --leave-one-out 0" if count > 2 else "")
            rows.append(_row("network", "views", str(count), how, count == 2, _timing(run), run.peak_mb, model=quality))
        return rows

    def fading(self, passes: int) -> Row:
        """The number of passes that fade and recolour Gaussians."""
        plain = passes == DEFAULT_PASSES
        run = self.whole if plain else timed(None, self.given, KEEP_ALL, REPEATS, self.threads, passes)
        quality = model_error(self.exact if plain else self._pictures(run.gaussians), self.truth, self.lpips)
        how = f"gapmes reconstruct --fade {passes}"
        return _row("network", "fading", str(passes), how, plain, _timing(run), run.peak_mb, model=quality)

    def scene(self, setting: knobs.SceneSetting) -> Row:
        """A pruned scene: render time, size of the .ply, change of colours and its bound."""
        run = timed(None, self.given, setting.budget, REPEATS, self.threads)
        pictures = self._pictures(run.gaussians)
        pruned = [document["pruning"] for document in run.documents]
        seconds = self._picture_seconds(lambda: draw(run.gaussians[0], self.camera, near=self.near(0)))
        stages = {"picture": seconds, "leaving out": float(run.stages["leave out"])}
        bound = None
        if setting.budget.stride == 1 and all(entry["certified"] is not None for entry in pruned):
            bound = Bound.of([entry["bound"] for entry in pruned], self._actual(run))
        return _row(
            "scene", setting.knob, setting.value, f"gapmes reconstruct {setting.how}", setting.default,
            Timing(seconds=seconds, stages=stages, repeats=PICTURE_REPEATS),
            megabytes=statistics.mean(len(ply_bytes(gaussians)) for gaussians in run.gaussians) / 1e6,
            setting=setting_error(pictures, self.exact),
            model=model_error(pictures, self.truth, self.lpips),
            bound=bound,
        )  # fmt: skip

    def _actual(self, run: Timed) -> list[float]:
        """The largest change in the pictures of the inputs, which are certified, of each scene."""
        found = []
        for index, document in enumerate(run.documents):
            views = [Camera(**_lens(entry)) for entry in document["view_cameras"]]
            pair = [drawn(sets.gaussians[index], views, self.near(index)) for sets in (run, self.whole)]
            found.append(setting_error(*pair).largest)
        return found

    def picture(self, setting: knobs.PictureSetting) -> Row:
        """A picture of the first scene at twice the network's size, against the most exact value of its knob."""
        gaussians, bound = self.whole.gaussians[0], None
        if setting.knob == knobs.BANDS:
            gaussians = _with_bands(gaussians)
        shots = [
            np.clip(draw(gaussians, self.camera, "rgb", effort, near=self.near(0)).rgb, 0, 1).transpose(2, 0, 1)
            for effort in (setting.effort, knobs.EXACT[setting.knob])
        ]
        error = setting_error(shots[:1], shots[1:])
        if setting.knob == knobs.BANDS:
            bound = Bound.of([_bands_bound(gaussians, setting.effort.sh_degree or 0)], [error.largest])
        if setting.knob in ("alpha cut", "cut radius"):
            efforts = (knobs.EXACT[setting.knob], setting.effort)
            exact, cut = (replace(effort.definition(), near=self.near(0)) for effort in efforts)
            bound = cut_bound(gaussians, self.camera, exact, cut)
        if setting.knob == "early stop":
            bound = Bound.of([setting.effort.stop * colour_range(gaussians)], [error.largest])
        seconds = self._picture_seconds(lambda: draw(gaussians, self.camera, "rgb", setting.effort, near=self.near(0)))
        return _row(
            "picture", setting.knob, setting.value, f"gapmes render {setting.how}".strip(), setting.default,
            Timing(seconds=seconds, stages={"picture": seconds}, repeats=PICTURE_REPEATS), setting=error, bound=bound,
        )  # fmt: skip

    def _picture_seconds(self, work: Callable[[], object]) -> float:
        times = []
        for _ in range(PICTURE_REPEATS + 1):
            start = time.perf_counter()
            work()
            times.append(time.perf_counter() - start)
        return statistics.median(times[1:])


def _row(group, knob, value, how, default, timing, peak_mb=None, *, megabytes=None, rounding=None,
         setting: SettingError | None = None, model=None, bound=None) -> Row:  # fmt: skip
    return Row(
        group=group, knob=knob, value=value, how=how, default=default, timing=timing, peak_mb=peak_mb,
        megabytes=megabytes, rounding=rounding, setting=setting, model=model, bound=bound,
    )  # fmt: skip


def _timing(run: Timed) -> Timing:
    return Timing(seconds=run.seconds, stages=run.stages, repeats=REPEATS)


def _lens(entry: dict) -> dict:
    lens = {name: float(entry[name]) for name in ("fx", "fy", "cx", "cy")}
    return {"width": entry["width"], "height": entry["height"], "world_from_cam": np.array(entry["c2w"]), **lens}


def _with_bands(gaussians: Gaussians) -> Gaussians:
    """The same set with random bands 1 to 3, since the shipped network yields constant colours only."""
    rng = np.random.default_rng(0)
    higher = rng.normal(0, 0.05, (len(gaussians), 15, 3)).astype(np.float32)
    return replace(gaussians, harmonics=np.concatenate([gaussians.harmonics[:, :1], higher], axis=1))


def _bands_bound(gaussians: Gaussians, degree: int) -> float:
    """Largest sum over the bands left out of their coefficients' norm times the most of the band's functions."""
    total = np.zeros((len(gaussians), 3))
    for band in range(degree + 1, 4):
        coefficients = gaussians.harmonics[:, band**2 : (band + 1) ** 2].astype(np.float64)
        total += BAND_NORMS[band - 1] * np.linalg.norm(coefficients, axis=1)
    return float(total.max(initial=0.0))
