"""Other readings of the poses: those that match alike are all named, and photographs that EXIF turns are one."""

from dataclasses import replace

import numpy as np
import pytest
from plane_scene import PlaneScene, photograph
from sample_photographs import sample_cameras, sample_pixels, sample_views

from gapmes.service.cameras.depth_range import DepthRange, depth_range
from gapmes.service.errors import ContradictionError
from gapmes.service.matching.photo_checks import check_photos
from gapmes.service.photographs.images import Photo, fit_view

DEPTHS = DepthRange(2.0, 8.0, "given")


def test_readings_that_match_alike_are_all_named():
    """Of two that look the same way through one lens: exchanged and inverted are one relative pose."""
    rng, cameras, lens = np.random.default_rng(5), [], PlaneScene.make(np.random.default_rng(5)).cameras[0]
    for place in ([-0.5, 0.0, 0.0], [0.1, 0.15, 0.1]):
        pose = np.eye(4)
        pose[:3, 3] = place
        cameras.append(lens.posed(pose))
    waves, phases = rng.normal(size=(3, 24, 2)) * 7, rng.uniform(0, 2 * np.pi, (3, 24))
    views = [fit_view(Photo(photograph(camera, waves, phases)), camera, 72, 96) for camera in cameras]
    assert check_photos(views, DEPTHS) == []
    swapped = [replace(v, camera=o.camera) for v, o in zip(views, reversed(views), strict=True)]
    with pytest.raises(ContradictionError) as caught:
        check_photos(swapped, DEPTHS)
    assert caught.value.cure.startswith(
        "these look like the cameras of the other photograph: swap the two cameras or images; "
        "or world-to-camera matrices: invert them,"
    )


@pytest.mark.parametrize("orientation", [2, 3, 4])
@pytest.mark.parametrize("indices", [(1, 5), (0, 3, 6)])
def test_photographs_that_exif_turns_are_named(indices, orientation):
    """Stored mirrored, upside down or both, while the cameras are those of what is seen."""
    views = sample_views(indices)
    turned = {2: np.s_[:, ::-1], 3: np.s_[::-1, ::-1], 4: np.s_[::-1]}[orientation]
    photos = [Photo(np.ascontiguousarray(sample_pixels(index)[turned]), orientation=orientation) for index in indices]
    stored = [fit_view(p, c, 256, 256) for p, c in zip(photos, sample_cameras(indices), strict=True)]
    depths = depth_range([view.camera for view in views])
    (notice,) = check_photos(stored, depths, trust_poses=True, numbers=range(4, 4 + len(views)))
    assert notice["code"] == "poses_doubtful"
    which = "4, 5" if len(views) == 2 else "4, 5, 6"
    cure = f"cameras of photographs that are turned as EXIF says: save photographs {which} turned so, without the tag"
    assert f"(these look like {cure}" in notice["message"]
    as_stored = [replace(view, orientation=orientation) for view in views]  # under cameras of what is stored
    assert check_photos(as_stored, depths) == []
