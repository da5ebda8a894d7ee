"""JSON schema of the form of `POST /reconstruct`: its parts with types, defaults and limits."""

from __future__ import annotations

from typing import Any

from ..cameras.leave_one_out import DEFAULT_OTHERS
from ..cameras.view_checks import MAX_VIEWS, MIN_VIEWS
from ..captures.select import DEFAULT_CONTEXT
from ..leaving_out.budget import DEFAULT_CERTIFY, MAX_CERTIFY
from ..leaving_out.stride import STRIDES
from ..mending.detail_level import DETAILS
from ..mending.fade_passes import DEFAULT_PASSES, MAX_PASSES
from ..model_names import DEFAULT
from .posted import MAX_IMAGES

# Two cameras side by side that look along z.
CAMERAS = (
    '{"near": 1.0, "far": 10.0, "views": ['
    '{"width": 640, "height": 480, "fx": 500.0, "fy": 500.0, "cx": 320.0, "cy": 240.0,'
    ' "c2w": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]},'
    ' {"width": 640, "height": 480, "fx": 500.0, "fy": 500.0, "cx": 320.0, "cy": 240.0,'
    ' "c2w": [[1, 0, 0, 0.3], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}]}'
)
FORM: dict[str, Any] = {
    "type": "object",
    "anyOf": [{"required": ["images", "cameras"]}, {"required": ["capture"]}],
    "properties": {
        "images": {
            "type": "array",
            "items": {"type": "string", "format": "binary"},
            "minItems": MIN_VIEWS,
            "maxItems": MAX_IMAGES,
        },
        "cameras": {
            "type": "string",
            "description": "cameras.json, transforms.json or a RealEstate10K text, as a field or as a file part;"
            " poses_bounds.npy or a zipped COLMAP model as a file part",
            "examples": [CAMERAS],
        },
        "capture": {
            "type": "string",
            "format": "binary",
            "description": "instead of images and cameras: a zip of both",
        },
        "select": {
            "type": "string",
            "description": "which views to use, by index or by name, comma separated",
            "examples": ["0,4"],
        },
        "context": {
            "type": "integer",
            "minimum": MIN_VIEWS,
            "maximum": MAX_VIEWS,
            "description": f"how many views to choose; of a capture of more than 6 without it {DEFAULT_CONTEXT}",
        },
        "near": {"type": "number", "exclusiveMinimum": 0, "description": "nearest depth, in the cameras' units"},
        "far": {"type": "number", "exclusiveMinimum": 0, "description": "farthest depth, in the cameras' units"},
        "views": {
            "type": "string",
            "description": "views to render, comma separated",
            "examples": ["0,1.5,orbit:30"],
        },
        "trust_poses": {
            "type": "boolean",
            "description": "warn only, where photographs or overlap speak against the poses",
        },
        "refine_poses": {
            "type": "boolean",
            "description": "correct poses and focal lengths that are slightly wrong, to match each other",
        },
        "max_error": {
            "type": "string",
            "default": "1/255",
            "examples": ["1/255", "0", "off"],
            "description": "change of colour up to which Gaussians are left out, proved for the inputs, the views"
            " between them and `views`: a number, a fraction, or off",
        },
        "certify": {
            "type": "integer",
            "minimum": 0,
            "maximum": MAX_CERTIFY,
            "default": DEFAULT_CERTIFY,
            "description": "views between neighbouring inputs for which that is proved",
        },
        "leave_one_out": {
            "type": "integer",
            "enum": [0, *range(MIN_VIEWS, MAX_VIEWS)],
            "default": DEFAULT_OTHERS,
            "description": "of three photographs or more, how many others predict each; 0: none are predicted",
        },
        "fade": {
            "type": "integer",
            "minimum": 0,
            "maximum": MAX_PASSES,
            "default": DEFAULT_PASSES,
            "description": "passes that fade and recolour what the photographs contradict; 0: as the network gave it",
        },
        "detail": {
            "type": "integer",
            "enum": list(DETAILS),
            "default": 1,
            "description": "Gaussians per pixel of the network, each way, with the colours of the photographs' own",
        },
        "model": {
            "type": "string",
            "default": DEFAULT,
            "description": "a name that `GET /models` lists",
            "examples": [DEFAULT],
        },
        "min_opacity": {"type": "number", "minimum": 0, "maximum": 1, "default": 0, "description": "fainter ones go"},
        "stride": {
            "type": "integer",
            "enum": list(STRIDES),
            "default": 1,
            "description": "pixels per Gaussian, each way",
        },
    },
}
