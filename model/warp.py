"""Projection of pixels of one view into another at any depth; the depth-independent part is computed once."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

FRONT = 1e-4  # least z-depth in the source view, relative to that in the reference view
OUTSIDE = 4.0  # of every image of two pixels or more; backends disagree on samples that are huge or not finite


@dataclass(frozen=True)
class Warp:
    """Pixels of m reference views in m source views.

    A point is ray / d at an inverse depth d, so up to the positive factor d it is R ray + t d: no division by a small
    depth. `rays` has R ray, x and y times twice the focal length, each (m, a, b); `shifts` the same of t, each
    (m, 1, 1).
    """

    rays: tuple[Tensor, Tensor, Tensor]
    shifts: tuple[Tensor, Tensor, Tensor]
    centres: tuple[Tensor, Tensor]  # (m, 1, 1) of the source, -1 and 1 at the borders

    @staticmethod
    def make(rays: Tensor, source_intrinsics: Tensor, source_from_reference: Tensor) -> Warp:
        """rays (m, 3, a, b) with z = 1, K (m, 3, 3) normalised, motion (m, 4, 4)."""
        rotated = (source_from_reference[:, :3, :3] @ rays.flatten(2)).reshape(rays.shape)
        shift = source_from_reference[:, :3, 3, None, None]
        # axis by axis: onnxruntime is slow where the last axis has two or three numbers
        doubled = [2 * source_intrinsics[:, axis, axis, None, None] for axis in (0, 1)]
        centres = [2 * source_intrinsics[:, axis, 2, None, None] - 1 for axis in (0, 1)]
        return Warp(
            (doubled[0] * rotated[:, 0], doubled[1] * rotated[:, 1], rotated[:, 2]),
            (doubled[0] * shift[:, 0], doubled[1] * shift[:, 1], shift[:, 2]),
            (centres[0], centres[1]),
        )

    def positions(self, inverse_depth: Tensor) -> tuple[Tensor, Tensor]:
        """At inverse depths (m, c, d), whose shape broadcasts with that of the rays to (A, B): positions in [-1, 1]
        grid units (m, A, B, 2), outside the image wherever the point lies behind the source camera or anything is not
        finite, and a mask (m, A, B) of samples that fall inside."""
        return self._positions(inverse_depth, *self._before(inverse_depth))

    def points(self, inverse_depth: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """`positions`, and the inverse depth of each point in the source camera (m, A, B), 0 behind it."""
        safe, front = self._before(inverse_depth)
        return (*self._positions(inverse_depth, safe, front), torch.where(front, inverse_depth / safe, 0.0))

    def part(self, start: int, stop: int) -> Warp:
        """The rays of these rows alone."""
        x, y, z = (ray[:, start:stop] for ray in self.rays)
        return Warp((x, y, z), self.shifts, self.centres)

    def turned(self) -> Warp:
        """Rays (m, b, a)."""
        x, y, z = (ray.transpose(1, 2) for ray in self.rays)
        return Warp((x, y, z), self.shifts, self.centres)

    def _before(self, inverse_depth: Tensor) -> tuple[Tensor, Tensor]:
        """The ratio of z-depths in the source and the reference, 1 behind the source camera, and a mask of those in
        front."""
        z = self.rays[2] + self.shifts[2] * inverse_depth
        front = z > FRONT
        return torch.where(front, z, 1.0), front

    def _positions(self, inverse_depth: Tensor, safe: Tensor, front: Tensor) -> tuple[Tensor, Tensor]:
        axes = []
        for ray, shift, centre in zip(self.rays[:2], self.shifts[:2], self.centres, strict=True):
            at = (ray + shift * inverse_depth) / safe + centre
            axes.append(torch.where(front & (at.abs() < OUTSIDE), at, OUTSIDE))
        inside = (axes[0].abs() < 1) & (axes[1].abs() < 1)
        return torch.stack(axes, dim=-1), inside
