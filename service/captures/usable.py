"""Of many views those whose cameras can be used; a warning tells of the others."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ..camera_fields import CameraFile
from ..errors import IntrinsicsError, PoseError
from ..view_checks import MIN_VIEWS, Notice


def usable_views(
    indices: Sequence[int], cameras: Callable[[Sequence[int]], CameraFile]
) -> tuple[list[int], CameraFile, tuple[Notice, ...]]:
    """Those of the views whose lens can be made a pinhole and whose pose is one, their cameras, and the warning that
    others are not. Raises what the first of them raises where fewer than two are left."""
    try:
        return list(indices), cameras(indices), ()
    except (IntrinsicsError, PoseError):
        pass
    usable, refused = [], []
    for index in indices:
        try:
            cameras([index])
            usable.append(index)
        except (IntrinsicsError, PoseError) as error:
            refused.append(error)
    if len(usable) < MIN_VIEWS:
        raise refused[0]
    message = f"{len(refused)} of {len(indices)} views have no camera that can be used, the first: {refused[0]}"
    warning: Notice = {"code": "views_refused", "field": "cameras", "message": message}
    return usable, cameras(usable), (warning,)
