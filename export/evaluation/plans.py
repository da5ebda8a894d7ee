"""What an evaluation measures when little is asked for: the groups that the command's options stand for."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from gapmes.service.errors import InputError

from ..size import Size
from .case import NoSuchViews, suggested_views
from .models import model_sizes
from .run import GroupPlan

PHOTOGRAPH_SIZES = (Size.square(256), Size.square(128))
PHOTOGRAPH_INPUTS, GENERATED_INPUTS = (2, 3), (2,)
GENERATED_SIZE, MOST_GENERATED = Size.square(128), 100
GENERATED = {Size.square(256): 24, GENERATED_SIZE: MOST_GENERATED}  # scenes; one of 256 px takes four times as long


def evaluation_plans(
    scenes: Sequence[Path],
    generated: int | None,
    inputs: Sequence[int],
    sizes: Sequence[Size],
    files: Sequence[Path],
) -> list[GroupPlan]:
    """Photographs first, large sizes first. What is not given: see the constants.

    Without scenes and number of generated ones, the scenes beside the checkout and `GENERATED`. Without sizes, those of
    the ONNX `files`, where there are any. Raises `InputError` when that leaves nothing.
    """
    sizes = sizes or model_sizes(files)
    of_size = dict.fromkeys(sizes or (GENERATED_SIZE,), generated or 0)
    if not scenes and generated is None:
        scenes = neighbouring_scenes()
        of_size = {size: GENERATED.get(size, MOST_GENERATED) for size in sizes or GENERATED}
    plans = [
        GroupPlan(count, size, folders=tuple(scenes))
        for size in (sizes or PHOTOGRAPH_SIZES)
        for count in (inputs or PHOTOGRAPH_INPUTS)
        if scenes
    ]
    plans += [
        GroupPlan(count, size, generated=scenes_of_size)
        for size, scenes_of_size in of_size.items()
        for count in (inputs or GENERATED_INPUTS)
        if scenes_of_size
    ]
    if not plans:
        raise InputError("0 scenes and 0 generated ones", field="SCENE_DIR", cure="name a folder or --generated 100")
    return plans


def neighbouring_scenes() -> list[Path]:
    """Folders in `shared/scenes` beside the checkout that suggest two inputs with targets."""
    found = []
    for path in sorted((Path(__file__).resolve().parents[3] / "shared" / "scenes").glob("*/cameras.json")):
        try:
            suggested_views(path.parent, 2)
        except NoSuchViews:
            continue
        found.append(path.parent)
    return found
