"""How a scene is made from its photographs: the options of a reconstruction, checked before anything is loaded."""

from __future__ import annotations

from typing import NamedTuple

from .arguments import truth
from .cameras.leave_one_out import DEFAULT_OTHERS, checked_others
from .leaving_out.budget import Budget, checked_budget
from .mending.detail_level import checked_detail
from .mending.fade_passes import DEFAULT_PASSES, checked_passes


class Options(NamedTuple):
    """Of `Reconstructor.reconstruct`, which says what each means."""

    trust_poses: bool
    refine_poses: bool
    budget: Budget
    leave_one_out: int
    fade: int
    detail: int
    whole: bool


def checked_options(
    *,
    trust_poses: bool = False,
    refine_poses: bool = False,
    budget: Budget | None = None,
    leave_one_out: int = DEFAULT_OTHERS,
    fade: int = DEFAULT_PASSES,
    detail: int = 1,
    whole: bool = True,
) -> Options:
    """As they are used. Raises `InputError` for a value that none of them may have."""
    kept = checked_budget(budget)
    return Options(
        truth(trust_poses, "trust_poses"),
        truth(refine_poses, "refine_poses"),
        kept,
        checked_others(leave_one_out),
        checked_passes(fade),
        checked_detail(detail, kept.stride),
        truth(whole, "whole"),
    )
