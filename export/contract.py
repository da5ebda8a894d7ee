"""The ONNX contract: names, shapes, metadata keys and the sizes that a file accepts."""

from __future__ import annotations

INPUTS = ("images", "intrinsics", "world_from_cam", "near_far", "patch_mask")
GAUSSIAN_OUTPUTS = ("means", "scales", "rotations_wxyz", "opacities", "harmonics")
IMAGE_OUTPUTS = ("depth", "confidence")
ROUTING_OUTPUTS = ("expert_index", "expert_weight", "task_weight")

FORMAT = "1"  # gapmes.format: bumped when names or meanings change
OPSET = 20  # the newest that every backend named in the documentation reads
MIN_VIEWS, MAX_VIEWS = 2, 6
NEAR_FAR_RULE = "z-depth range in the units of the poses; candidates are uniform in 1/z from 1/far to 1/near"


def output_names(*, with_routing: bool) -> tuple[str, ...]:
    """Outputs in graph order; networks without a mixture have no routing outputs."""
    return GAUSSIAN_OUTPUTS + IMAGE_OUTPUTS + (ROUTING_OUTPUTS if with_routing else ())
