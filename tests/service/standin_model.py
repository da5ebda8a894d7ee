"""A stand-in for the network, built with onnx.helper under the same contract: geometry that can be checked by hand.

Every pixel of every view becomes one Gaussian at z-depth sqrt(near * far) on the ray of its pixel centre, coloured by
the pixel; `EXTRA` more per view stand behind. Scales, rotation and the first SH band are constants, so that units and
frames show. Patches that the mask leaves out have opacity 0. Weights are routed by a fixed rule.
"""

import json
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

HEIGHT, WIDTH, PATCH = 48, 64, 16
ROWS, COLUMNS = HEIGHT // PATCH, WIDTH // PATCH
EXTRA = 4  # Gaussians per view after the pixels, at twice the depth, at the centres of the quadrants
SCALES = np.array([0.01, 0.02, 0.03], np.float32)  # times the depth
ROTATION = np.array([0.5, 0.5, -0.5, 0.5], np.float32)  # wxyz
OPACITY = 0.9
C0 = 0.28209479177387814
BAND_1 = np.array([[0.1, 0.2, 0.3], [-0.1, 0.0, 0.1], [0.05, -0.2, 0.15]], np.float32)  # m = -1, 0, 1 by channel
METADATA = {
    "format": "1",
    "preset": "standin",
    "config": json.dumps({"sh_degree": 1}),
    "weights_sha256": "0" * 64,
    "opset": "18",
    "height": str(HEIGHT),
    "width": str(WIDTH),
    "patch_px": str(PATCH),
    "near_far": "any",
    "licence": "MIT",
    "precision": "fp32",
    "tolerance": "{}",
}


def write_standin(path: Path, metadata: dict[str, str] | None = None, outputs: tuple[str, ...] | None = None) -> Path:
    """Write the model; `metadata` replaces the default one, `outputs` keeps only these."""
    graph = _Graph()
    build(graph)
    kept = [value for value in _outputs() if outputs is None or value.name in outputs]
    onnx_graph = helper.make_graph(graph.nodes, "standin", _inputs(), kept, graph.constants)
    model = helper.make_model(onnx_graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
    helper.set_model_props(
        model, {f"gapmes.{key}": value for key, value in (METADATA if metadata is None else metadata).items()}
    )
    onnx.checker.check_model(model)
    path.write_bytes(model.SerializeToString())
    return path


class _Graph:
    """Nodes and constants in the order in which they were added; every call returns the name of its result."""

    def __init__(self) -> None:
        self.nodes: list = []
        self.constants: list = []

    def constant(self, value: np.ndarray) -> str:
        name = f"constant_{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.asarray(value), name))
        return name

    def shape(self, *sides: int) -> str:
        return self.constant(np.array(sides, np.int64))

    def __call__(self, kind: str, *inputs: str, to: str | None = None, **attributes: object) -> str:
        name = to or f"{kind.lower()}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, list(inputs), [name], **attributes))
        return name


def build(g: _Graph) -> None:
    f32 = np.float32
    near_far = g("Gather", "near_far", g.constant(np.int64(0))), g("Gather", "near_far", g.constant(np.int64(1)))
    depth = g("Sqrt", g("Mul", *near_far))
    grid = np.stack(np.meshgrid((np.arange(WIDTH) + 0.5) / WIDTH, (np.arange(HEIGHT) + 0.5) / HEIGHT), -1).reshape(
        -1, 2
    )
    quarter = np.array([[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75]])
    # camera rays (V, 3, M) = K^-1 [u, v, 1]; pixels first, then the extra ones
    pixel_points = _points(g, grid, depth)
    far_points = _points(g, quarter, g("Mul", depth, g.constant(f32(2))))
    g("Concat", pixel_points, far_points, axis=0, to="means")
    count = g("Gather", g("Shape", "means"), g.shape(0))  # (1,) = N
    views = g("Gather", g("Shape", "images"), g.shape(0))  # (1,) = V

    def filled(row: np.ndarray, to: str) -> str:
        tail = g.shape(*row.shape)
        return g("Expand", g.constant(row[None].astype(f32)), g("Concat", count, tail, axis=0), to=to)

    g("Mul", filled(SCALES, "unit_scales"), depth, to="scales")
    filled(ROTATION, "rotations_wxyz")
    colours = g("Reshape", g("Transpose", "images", perm=[0, 2, 3, 1]), g.shape(-1, 1, 3))
    grey = g(
        "Expand",
        g.constant(np.full((1, 1, 3), 0.5, f32)),
        g("Concat", g("Mul", views, g.shape(EXTRA)), g.shape(1, 3), axis=0),
    )
    dc = g("Div", g("Sub", g("Concat", colours, grey, axis=0), g.constant(f32(0.5))), g.constant(f32(C0)))
    g("Concat", dc, filled(BAND_1, "band_1"), axis=1, to="harmonics")

    mask = _cast(g, "patch_mask")
    tiles = g("Reshape", mask, g.shape(-1, ROWS, 1, COLUMNS, 1))
    pixels = g("Expand", tiles, g.shape(1, 1, PATCH, 1, PATCH))
    opaque = g("Mul", g("Reshape", pixels, g.shape(-1)), g.constant(f32(OPACITY)))
    behind = g("Expand", g.constant(np.full((1,), OPACITY, f32)), g("Mul", views, g.shape(EXTRA)))
    g("Concat", opaque, behind, axis=0, to="opacities")

    maps = g("Concat", views, g.shape(HEIGHT, WIDTH), axis=0)
    g("Expand", depth, maps, to="depth")
    g("Expand", g.constant(np.full((1, 1, 1), 0.5, f32)), maps, to="confidence")
    patches = g("Concat", views, g.shape(ROWS * COLUMNS), axis=0)
    for name, row in (
        ("expert_index", np.array([1, 4], np.int64)),
        ("expert_weight", np.array([0.75, 0.25], f32)),
        ("task_weight", np.array([0.7, 0.1, 0.1, 0.1], f32)),
    ):
        g("Expand", g.constant(row[None, None]), g("Concat", patches, g.shape(len(row)), axis=0), to=name)
    g("Expand", g.constant(np.full((1, 1), 0.5, f32)), patches, to="route_margin")


def _points(g: _Graph, positions: np.ndarray, depth: str) -> str:
    """(V * M, 3) points in the frame of the poses at z-depth `depth` behind normalised positions (M, 2)."""
    homogeneous = np.concatenate([positions, np.ones((len(positions), 1))], axis=1).T[None].astype(np.float32)
    rays = g("MatMul", _inverse_intrinsics(g), g.constant(homogeneous))
    rotation = g("Slice", "world_from_cam", g.shape(0, 0), g.shape(3, 3), g.shape(1, 2))
    centre = g("Slice", "world_from_cam", g.shape(0, 3), g.shape(3, 4), g.shape(1, 2))
    points = g("Add", g("MatMul", rotation, g("Mul", rays, depth)), centre)
    return g("Reshape", g("Transpose", points, perm=[0, 2, 1]), g.shape(-1, 3))


def _inverse_intrinsics(g: _Graph) -> str:
    """Closed form for zero skew: [[1/fx, 0, -cx/fx], [0, 1/fy, -cy/fy], [0, 0, 1]]."""

    def entry(row: int, column: int) -> str:
        return g("Slice", "intrinsics", g.shape(row, column), g.shape(row + 1, column + 1), g.shape(1, 2))

    fx, fy, cx, cy, one = entry(0, 0), entry(1, 1), entry(0, 2), entry(1, 2), entry(2, 2)
    zero = g("Sub", one, one)
    rows = [
        g("Concat", g("Div", one, fx), zero, g("Neg", g("Div", cx, fx)), axis=2),
        g("Concat", zero, g("Div", one, fy), g("Neg", g("Div", cy, fy)), axis=2),
        g("Concat", zero, zero, one, axis=2),
    ]
    return g("Concat", *rows, axis=1)


def _cast(g: _Graph, name: str) -> str:
    g.nodes.append(helper.make_node("Cast", [name], [f"{name}_f32"], to=TensorProto.FLOAT))
    return f"{name}_f32"


def _inputs() -> list:
    f32 = TensorProto.FLOAT
    return [
        helper.make_tensor_value_info("images", f32, ["V", 3, HEIGHT, WIDTH]),
        helper.make_tensor_value_info("intrinsics", f32, ["V", 3, 3]),
        helper.make_tensor_value_info("world_from_cam", f32, ["V", 4, 4]),
        helper.make_tensor_value_info("near_far", f32, [2]),
        helper.make_tensor_value_info("patch_mask", TensorProto.BOOL, ["V", ROWS * COLUMNS]),
    ]


def _outputs() -> list:
    f32, patches = TensorProto.FLOAT, ROWS * COLUMNS
    shapes = {
        "means": ["N", 3],
        "scales": ["N", 3],
        "rotations_wxyz": ["N", 4],
        "opacities": ["N"],
        "harmonics": ["N", 4, 3],
        "depth": ["V", HEIGHT, WIDTH],
        "confidence": ["V", HEIGHT, WIDTH],
        "expert_index": ["V", patches, 2],
        "expert_weight": ["V", patches, 2],
        "task_weight": ["V", patches, 4],
        "route_margin": ["V", patches],
    }
    return [
        helper.make_tensor_value_info(name, TensorProto.INT64 if name == "expert_index" else f32, shape)
        for name, shape in shapes.items()
    ]
