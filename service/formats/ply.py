"""The 3DGS dialect of .ply: logit opacity, log scales, wxyz rotation, channel-major harmonics, world frame."""

from .ply_read import inspect_ply as inspect_ply
from .ply_read import read_ply as read_ply
from .ply_write import ply_bytes as ply_bytes
from .ply_write import write_ply as write_ply
