"""An engine that remembers its last run: what the network saw and returned is not part of a scene."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gapmes.service.network.engine import Arrays, Engine

F32 = NDArray[np.float32]


class RecordingEngine(Engine):
    """Keeps the images and the outputs of the last run; for one caller at a time."""

    images: F32  # (V, 3, H, W) in [0, 1]
    last: Arrays

    def run(
        self,
        images: F32,
        intrinsics: F32,
        world_from_cam: F32,
        near_far: F32,
        patch_mask: NDArray[np.bool_],
    ) -> Arrays:
        """As `Engine.run`."""
        self.images = images
        self.last = super().run(images, intrinsics, world_from_cam, near_far, patch_mask)
        return self.last
