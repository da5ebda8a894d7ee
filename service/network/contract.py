"""The ONNX contract: names of inputs and outputs, the format's version, and how many views a file takes."""

from __future__ import annotations

INPUTS = ("images", "intrinsics", "world_from_cam", "near_far", "patch_mask")
GAUSSIAN_OUTPUTS = ("means", "scales", "rotations_wxyz", "opacities", "harmonics")
IMAGE_OUTPUTS = ("depth", "confidence")
REQUIRED_OUTPUTS = GAUSSIAN_OUTPUTS + IMAGE_OUTPUTS
# A network without experts or without a task gate has no such outputs.
EXPERT_OUTPUTS = ("expert_index", "expert_weight")
TASK_OUTPUTS = ("task_weight",)
# How far rounding is from changing a patch's route; files that do not tell it are served all the same.
MARGIN_OUTPUTS = ("route_margin",)
OPTIONAL_OUTPUTS = EXPERT_OUTPUTS + TASK_OUTPUTS + MARGIN_OUTPUTS

# Below this margin another runtime may choose another route: the margins of the shipped network in onnxruntime and in
# torch differ by at most 2.9e-4 (by 9e-5 for 99 % of the patches) on the verification's scenes that have texture.
AMBIGUOUS_MARGIN = 3e-4

FORMAT = "1"  # gapmes.format: bumped when names or meanings change
