"""The groups of an evaluation, from the command's options and their defaults."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from gapmes.service.errors import InputError
from gapmes.service.plain_number import counted

from ..size import Size
from .case import GENERATED_SEED
from .labels import given_twice, shortest_names
from .models import exports, model_sizes
from .run import GroupPlan
from .suggested import suggestions

PHOTOGRAPH_SIZES = (Size.square(256), Size.square(128))
PHOTOGRAPH_INPUTS, GENERATED_INPUTS = (2, 3), (2,)
SCENE_SECONDS = 22.0  # of a processor: one scene of 256 px from two views; half of it is for the baselines
START_SECONDS, EXPORT_SECONDS = 12.0, 130.0  # the same; of an export with its verification
GENERATED_SIZE, MOST_GENERATED = Size.square(128), 100
GENERATED = {Size.square(256): 24, GENERATED_SIZE: MOST_GENERATED}  # scenes; one of 256 px takes four times as long


def evaluation_plans(
    scenes: Sequence[Path],
    generated: int | None,
    inputs: Sequence[int],
    sizes: Sequence[Size],
    files: Sequence[Path],
    seed: int | None = None,
    *,
    whole: bool = False,
) -> list[GroupPlan]:
    """Photographs first, large sizes first; defaults are the constants above.

    Without `scenes` and `generated`: the scenes beside the checkout and `GENERATED`. Without `sizes`: those of the ONNX
    `files`, if any. Raises `InputError` when nothing is left, for a scene, number of inputs or size given twice, and
    for a seed without generated scenes.
    """
    _check_once("inputs", inputs)
    _check_once("size", sizes)
    sizes = sizes or model_sizes(files)
    of_size = dict.fromkeys(sizes or (GENERATED_SIZE,), generated or 0)
    if not scenes and generated is None:
        scenes = neighbouring_scenes()
        of_size = {size: GENERATED.get(size, MOST_GENERATED) for size in sizes or GENERATED}
    if (twice := given_twice(scenes)) is not None:
        raise InputError(f"{twice} is given twice and would count so in the means", field="SCENE_DIR")
    folders = dict(zip(shortest_names(scenes), scenes, strict=True))
    plans = [
        GroupPlan(count, size, folders=folders, whole=whole)
        for size in (sizes or PHOTOGRAPH_SIZES)
        for count in (inputs or PHOTOGRAPH_INPUTS)
        if scenes
    ]
    plans += [
        GroupPlan(count, size, generated=scenes_of_size, seed=GENERATED_SEED if seed is None else seed)
        for size, scenes_of_size in of_size.items()
        for count in (inputs or GENERATED_INPUTS)
        if scenes_of_size
    ]
    if not plans:
        raise InputError("0 scenes and 0 generated ones", field="SCENE_DIR", cure="name a folder or --generated 100")
    if seed is not None and not any(plan.generated for plan in plans):
        raise InputError(f"is {seed}, but no scene is generated", field="seed", cure="add --generated 100")
    return plans


def outlook(plans: Sequence[GroupPlan], files: Sequence[Path], engines: int) -> str:
    """What `plans` measure with these files in so many engines, and roughly for how long."""
    scenes, seconds = [], 0.0
    for plan in plans:
        scenes.append(f"{counted(plan.count, 'scene')} of {plan.size} px from {plan.inputs} views ({plan.kind})")
        pixels = plan.inputs * plan.size.height * plan.size.width
        seconds += plan.count * SCENE_SECONDS * pixels * plan.inputs / (2 * 256**2 * 2)  # each view meets each
    first = exports(files, list(dict.fromkeys(plan.size for plan in plans)))
    seconds *= (1 + engines * max(1, len(files))) / 2
    minutes = (START_SECONDS + seconds + len(first) * EXPORT_SECONDS) / 60
    made = "".join(f"; exports and verifies {name} for {size} px first" for name, size in first)
    return f"measures {', '.join(scenes)}{made}: about {max(1, round(minutes))} min of processor time"


def _check_once(field: str, values: Sequence[int | Size]) -> None:
    for place, value in enumerate(values):
        if value in values[:place]:
            raise InputError(f"{value} is given twice and would count so in the means", field=field)


def neighbouring_scenes() -> list[Path]:
    """Folders in `shared/scenes` beside the checkout that suggest two inputs with targets."""
    found = []
    for folder in sorted((Path(__file__).resolve().parents[3] / "shared" / "scenes").glob("*/")):
        suggested = suggestions(folder) or {}
        if suggested.get("context2") and suggested.get("target2"):
            found.append(folder)
    return found
