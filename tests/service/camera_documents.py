"""A cameras.json and a transforms.json of the same cameras, and copies with one value broken."""

import copy

import numpy as np

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.camera_file import camera_document
from gapmes.service.cameras.rotations import about_axis

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


def pose(index=0):
    matrix = np.eye(4)
    matrix[:3, :3] = about_axis(np.array([0.6, 0.0, 0.8]), 0.3 + index)
    matrix[:3, 3] = [1.5 + index, -2.0, 0.25]
    return matrix


def our_file(count=2):
    cameras = [Camera.make(640, 480, 500.5, 510.25, 322, 236.5, pose(i)) for i in range(count)]
    views = [camera_document(camera, f"images/{i:03d}.png") for i, camera in enumerate(cameras)]
    return {"near": 1, "far": 20.5, "views": views, "licence": "CC0", "suggested": {"context2": [0, 1]}}


def transforms(count=2, **top):
    frames = [{"file_path": f"images/{i}.png", "transform_matrix": (pose(i) @ FLIP).tolist()} for i in range(count)]
    return {"fl_x": 500.0, "fl_y": 510.0, "cx": 322.0, "cy": 236.5, "w": 640, "h": 480, "frames": frames} | top


def broken(path, value, base=None):
    file = copy.deepcopy(our_file() if base is None else base)
    target = file
    for key in path[:-1]:
        target = target[key]
    if value is None:
        del target[path[-1]]
    else:
        target[path[-1]] = value
    return file
