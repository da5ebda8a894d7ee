"""The scenes of a report: inputs as the service is given them, and targets that are held out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gapmes.service.photographs.images import FittedView

from ..evaluation.case import Case, photograph_case
from ..evaluation.scene_views import scene_views
from .child import Given

SIZE = 256  # px of the targets


@dataclass(frozen=True, eq=False)
class Scene:
    """Two inputs and their targets; `more` is the same with further inputs, by their number."""

    name: str
    given: Given
    targets: tuple[FittedView, ...]
    more: dict[int, Given]


def load_scene(folder: Path, name: str | None = None) -> Scene:
    """The two inputs and the targets of a capture (`scene_views`); up to two further inputs where views are left over.
    The folder's own name unless another is given.

    Raises `InputError` for what is no capture and for views that are not there.
    """
    case = photograph_case(folder, 2, SIZE, SIZE, name)
    return Scene(case.name, _given(case), case.targets, _more(folder, case))


def _given(case: Case) -> Given:
    return Given(case.photos, case.cameras, case.near, case.far)


def _more(folder: Path, case: Case) -> dict[int, Given]:
    scene = scene_views(folder, 2)
    context, spare = scene.inputs.indices, scene.spare()
    found = {}
    for count in (3, 4):
        extra = count - len(context)
        if len(spare) < extra:
            break
        chosen = sorted([*context, *(spare[i] for i in np.linspace(0, len(spare) - 1, extra).round().astype(int))])
        views = scene.capture.views(chosen)
        photographs = [scene.photograph(views, place) for place in range(count)]
        found[count] = Given([p for p, _ in photographs], [c for _, c in photographs], case.near, case.far)
    return found
