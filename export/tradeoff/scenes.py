"""The scenes of a report: inputs as the service is given them, and targets that are held out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gapmes.service.photographs.images import FittedView

from ..evaluation.case import Case, opaque_view, photograph_case
from ..evaluation.suggested import suggested_views
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
    """The suggested two inputs and their targets; up to two further inputs where views are left over. The folder's own
    name unless another is given.

    Raises `InputError` for what is no scene folder and for views that are not there.
    """
    case = photograph_case(folder, 2, SIZE, SIZE, name)
    return Scene(case.name, _given(case), case.targets, _more(folder, case))


def _given(case: Case) -> Given:
    return Given(case.photos, case.cameras, case.near, case.far)


def _more(folder: Path, case: Case) -> dict[int, Given]:
    suggested = suggested_views(folder, 2)
    scene, context, targets = suggested.scene, suggested.inputs, suggested.targets
    spare = [i for i in range(len(scene.file.views)) if i not in (*context, *targets)]
    found = {}
    for count in (3, 4):
        extra = count - len(context)
        if len(spare) < extra:
            break
        chosen = sorted([*context, *(spare[i] for i in np.linspace(0, len(spare) - 1, extra).round().astype(int))])
        views = [opaque_view(scene, index) for index in chosen]
        found[count] = Given([p for p, _ in views], [c for _, c in views], case.near, case.far)
    return found
