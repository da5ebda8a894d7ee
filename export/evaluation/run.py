"""A whole evaluation: every scene of all groups, the report and its pictures."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from gapmes.model.training.lpips import Lpips
from gapmes.service.errors import InputError
from gapmes.service.mending.fade_passes import DEFAULT_PASSES
from gapmes.service.network.backends.choice import DEFAULT_ENGINE, EngineName
from gapmes.service.process.output_file import check_output_folder
from gapmes.service.progress import Listener, Stages, silent

from ..size import Size
from .case import GENERATED_SEED, Case, generated_cases, photograph_case
from .labels import GENERATED_STEM, file_stems
from .measure import Measured, measure
from .models import Model, check_sizes, load_models
from .report import Report
from .routing import routing_statistics
from .scene_views import scene_views
from .scores import Group
from .sheets import scene_sheet
from .suggested import NoSuchViews

GENERATED_SHEETS = 8  # generated scenes with a picture, those of the smallest margins; photographs all have one


@dataclass(frozen=True)
class GroupPlan:
    """Scenes that are evaluated alike: captures of photographs, or a number of generated ones."""

    inputs: int
    size: Size
    folders: Mapping[str, Path] = field(default_factory=dict)  # label -> capture
    generated: int = 0
    seed: int = GENERATED_SEED  # of the generated ones
    left_out: Mapping[str, str] = field(default_factory=dict)  # label -> reason, of captures without such views
    whole: bool = False  # photographs as a whole instead of cropped to the aspect of `size`

    @property
    def kind(self) -> str:
        return "generated" if self.generated else "photographs"

    @property
    def count(self) -> int:
        return self.generated or len(self.folders)


def evaluate(
    plans: Sequence[GroupPlan],
    out: Path,
    *,
    files: Sequence[Path] = (),
    engines: Sequence[EngineName] = (DEFAULT_ENGINE,),
    lpips: Path | None = None,
    twice: bool = False,
    fade: int = DEFAULT_PASSES,
    threads: int | None = None,
    listener: Listener = silent,
) -> Report:
    """Evaluate every plan and write report.json, report.md and pictures into `out`.

    A capture without inputs and targets for a plan is left out, with the reason in the report. Raises `GapmesError`.
    """
    sizes = sorted({plan.size for plan in plans}, key=Size.order, reverse=True)
    check_output_folder(out, field="out")  # before the work, as everything here
    check_sizes(files, sizes)  # here and not one by one: an export takes minutes
    plans = [_looked_at(plan) for plan in plans]
    weights = None if lpips is None else Lpips.load(lpips)
    out.mkdir(parents=True, exist_ok=True)
    stages = Stages(listener)
    with tempfile.TemporaryDirectory() as scratch:
        models = load_models(files, sizes, Path(scratch), engines=engines, threads=threads, listener=listener)
    report = Report(models, [], None if lpips is None else lpips.name, fade)
    for plan in plans:
        ours = [model for model in models if model.size == plan.size]
        with stages.stage(f"{plan.kind[:5]} {plan.inputs}v {plan.size}", plan.count) as done:
            of_case = partial(measure, models=ours, lpips=weights, twice=twice, fade=fade, threads=threads)
            group = _group(plan, ours, out, of_case, done)
        report = replace(report, groups=[*report.groups, group])
        report.write(out)  # after every group, so that an interrupted run leaves what it has
    return report


def _group(
    plan: GroupPlan,
    models: Sequence[Model],
    out: Path,
    of_case: Callable[[Case], Measured],
    done: Callable[[int], None],
) -> Group:
    first = models[0].label
    scenes, routes = [], []
    ending = f"_{plan.inputs}views_{plan.size}px{'_whole' if plan.whole else ''}.png"
    if plan.generated:
        for earlier in out.glob(f"generated_*{ending}"):  # which scenes are worst depends on the model
            if GENERATED_STEM.fullmatch(earlier.name.removesuffix(ending)):
                earlier.unlink()
    worst: list[tuple[Case, Measured]] = []
    stems = file_stems(plan.folders)

    def draw(case: Case, measured: Measured) -> None:
        sheet = scene_sheet(case, measured, first)
        sheet.save(out / f"{stems[case.name]}{ending}")

    for number, case in enumerate(_cases(plan), start=1):
        measured = of_case(case)
        scenes.append(measured.score)
        routes.append(measured.routes)
        if plan.generated:
            worst = sorted([*worst, (case, measured)], key=lambda pair: pair[1].score.margin(first))
            del worst[GENERATED_SHEETS:]
        else:
            draw(case, measured)
        done(number)
    stems |= {case.name: case.name.replace(" ", "_") for case, _ in worst}
    for case, measured in worst:
        draw(case, measured)
    statistics = {
        model.label: routing_statistics(
            [scene[model.label] for scene in routes], model.engine.info.config.get("experts"), model.lambdas
        )
        for model in models
    }
    source = "true depth" if plan.generated else f"rendered depth of {first}"
    seed = plan.seed if plan.generated else None
    return Group(plan.kind, plan.inputs, plan.size, source, scenes, statistics, plan.left_out, seed, plan.whole)


def _looked_at(plan: GroupPlan) -> GroupPlan:
    """The plan with the captures that can be evaluated. Raises `InputError` for one that is none, has an unusable
    photograph, or is named a second time, and where none is left."""
    folders: dict[str, Path] = {}
    refused: dict[str, NoSuchViews] = {}
    known: dict[Path, str] = {}
    for name, folder in plan.folders.items():
        try:
            camera_file = scene_views(folder, plan.inputs).camera_file
            photograph_case(folder, plan.inputs, *plan.size)
        except NoSuchViews as refusal:
            refused[name] = refusal
            continue
        if (same := known.setdefault(camera_file, name)) != name:
            message = f"{name} and {same} are one capture, and would count so in the means: cameras of {camera_file}"
            raise InputError(message, field="SCENE_DIR", cure="name it once, by its folder or its camera file")
        folders[name] = folder
    if refused and not folders:
        reasons = "; ".join(f"{name}: {refusal.message}" for name, refusal in refused.items())
        cure = next(iter(refused.values())).cure
        message = f"no scene has {plan.inputs} inputs with targets ({reasons})"
        raise InputError(message, field="SCENE_DIR", cure=cure)
    return replace(plan, folders=folders, left_out={name: str(refusal) for name, refusal in refused.items()})


def _cases(plan: GroupPlan) -> Iterator[Case]:
    if plan.generated:
        yield from generated_cases(plan.generated, plan.inputs, *plan.size, seed=plan.seed)
    for name, folder in plan.folders.items():
        yield photograph_case(folder, plan.inputs, *plan.size, name=name, whole=plan.whole)
