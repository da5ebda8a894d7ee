"""The one error tree: every refusal has an HTTP status, a stable code, the field it is about and a cure.

GapmesError                     500 internal_error
├── InputError                  422 invalid_input
│   ├── CameraError             422 camera_invalid
│   │   ├── PoseError           422 pose_not_rotation
│   │   ├── IntrinsicsError     422 intrinsics_implausible
│   │   ├── OverlapError        422 views_do_not_overlap
│   │   ├── BaselineError       422 no_baseline
│   │   ├── ContradictionError  422 photos_contradict_poses
│   │   └── DepthRangeError     422 depth_range_invalid
│   ├── ImageError              422 image_invalid
│   │   ├── ImageUnreadable     415 image_unreadable
│   │   └── ImageTooLarge       413 image_too_large
│   ├── CaptureError            422 capture_invalid
│   ├── ViewCountError          422 view_count
│   ├── ViewError               422 view_unknown
│   ├── ModelUnknown            422 model_unknown
│   ├── GaussiansError          422 gaussians_invalid
│   ├── TooManyGaussians        413 too_many_gaussians
│   └── FormatError             422 format_invalid
│       └── PlyError            422 ply_invalid
├── MalformedRequest            400 malformed_request
├── UnsupportedMediaType        415 unsupported_media_type
├── NotAcceptable               406 not_acceptable
├── UploadTooLarge              413 upload_too_large
├── UploadTimeout               408 upload_timeout
├── SceneNotFound               404 scene_not_found
├── FormatUnknown               404 format_unknown
├── JobNotFound                 404 job_not_found
├── Unauthorized                401 unauthorized
├── OriginRefused               403 origin_refused
├── HostRefused                 421 host_refused
├── ModelError                  500 model_invalid
├── ServiceBusy                 503 service_busy
│   └── ModelNotReady           503 model_not_ready
├── DeadlineExceeded            504 deadline_exceeded
├── JobCancelled                409 job_cancelled
├── ModelChanged                409 model_changed
├── InputsGone                  410 inputs_gone
└── StorageFull                 507 storage_full
"""

from __future__ import annotations

from typing import Any, ClassVar

MORE_MEMORY = "give it more memory (a container's limit, ulimit -v), or fewer and smaller photographs and pictures"


class GapmesError(Exception):
    """Base of all refusals; `message` says what is wrong with both numbers, `cure` what to do about it."""

    status: ClassVar[int] = 500
    code: ClassVar[str] = "internal_error"

    def __init__(
        self, message: str, *, field: str | None = None, index: int | None = None, cure: str | None = None, **extra: Any
    ) -> None:
        super().__init__(message)
        self.message = message
        self.field = field
        self.index = index
        self.cure = cure
        if index is not None:
            self.add_note(f"index: {index}")  # a traceback shows it; the text for people has it where it belongs
        self.extra = extra

    def __str__(self) -> str:
        where = "" if self.field is None else f"{self.field}: "
        cure = "" if self.cure is None else f" ({self.cure})"
        return f"{where}{self.message}{cure}"


class InputError(GapmesError):
    status = 422
    code = "invalid_input"


class CameraError(InputError):
    code = "camera_invalid"


class PoseError(CameraError):
    code = "pose_not_rotation"


class IntrinsicsError(CameraError):
    code = "intrinsics_implausible"


class OverlapError(CameraError):
    code = "views_do_not_overlap"


class BaselineError(CameraError):
    code = "no_baseline"


class ContradictionError(CameraError):
    code = "photos_contradict_poses"


class DepthRangeError(CameraError):
    code = "depth_range_invalid"


class ImageError(InputError):
    code = "image_invalid"


class ImageUnreadable(ImageError):
    status = 415
    code = "image_unreadable"


class ImageTooLarge(ImageError):
    status = 413
    code = "image_too_large"


class CaptureError(InputError):
    code = "capture_invalid"


class ViewCountError(InputError):
    code = "view_count"


class ViewError(InputError):
    code = "view_unknown"


class ModelUnknown(InputError):
    code = "model_unknown"


class GaussiansError(InputError):
    code = "gaussians_invalid"


class TooManyGaussians(InputError):
    status = 413
    code = "too_many_gaussians"


class FormatError(InputError):
    code = "format_invalid"


class PlyError(FormatError):
    code = "ply_invalid"


class MalformedRequest(GapmesError):
    status = 400
    code = "malformed_request"


class UnsupportedMediaType(GapmesError):
    status = 415
    code = "unsupported_media_type"


class NotAcceptable(GapmesError):
    status = 406
    code = "not_acceptable"


class UploadTooLarge(GapmesError):
    status = 413
    code = "upload_too_large"


class UploadTimeout(GapmesError):
    status = 408
    code = "upload_timeout"


class SceneNotFound(GapmesError):
    status = 404
    code = "scene_not_found"


class FormatUnknown(GapmesError):
    status = 404
    code = "format_unknown"


class JobNotFound(GapmesError):
    status = 404
    code = "job_not_found"


class Unauthorized(GapmesError):
    status = 401
    code = "unauthorized"


class OriginRefused(GapmesError):
    status = 403
    code = "origin_refused"


class HostRefused(GapmesError):
    status = 421
    code = "host_refused"


class ModelError(GapmesError):
    code = "model_invalid"


class ServiceBusy(GapmesError):
    status = 503
    code = "service_busy"


class ModelNotReady(ServiceBusy):
    code = "model_not_ready"


class DeadlineExceeded(GapmesError):
    status = 504
    code = "deadline_exceeded"


class JobCancelled(GapmesError):
    status = 409
    code = "job_cancelled"


class ModelChanged(GapmesError):
    status = 409
    code = "model_changed"


class InputsGone(GapmesError):
    status = 410
    code = "inputs_gone"


class StorageFull(GapmesError):
    status = 507
    code = "storage_full"
