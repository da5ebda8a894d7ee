"""Schemas of the JSON answers for the OpenAPI document. Routes do not use them; tests validate answers against them."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

FormatName = Literal["ply", "compressed.ply", "splat", "spz"]  # of a file of Gaussians
_SCENE = "3f0c1e5a9b7d42868a1f0e2d4c6b8a90"
_JOB = "9d1e6c2b4f8a40d7b3e59c0a7f1d2e64"


def _with(example: dict[str, Any], *, more: bool = False) -> ConfigDict:
    """`more`: members beside those that are listed."""
    return ConfigDict(json_schema_extra={"examples": [example]}, extra="allow" if more else "ignore")


class Problem(BaseModel):
    """An error (RFC 9457); `code` is stable, absent members are left out, some errors have more."""

    model_config = _with(
        {
            "type": "urn:gapmes:problem:pose_not_rotation", "title": "Pose not rotation", "status": 422,
            "detail": "det(R) = -1, need +1", "code": "pose_not_rotation", "field": "views.c2w", "index": 1,
            "cure": "one axis is mirrored; is the source left-handed?",
        },
        more=True,
    )  # fmt: skip
    type: str
    title: str
    status: int = Field(ge=400, le=599)
    detail: str
    code: str
    field: str = Field("", description="the part, parameter or member that it is about")
    index: int = Field(0, ge=0, description="which image or view, counted from 0")
    cure: str = Field("", description="what to do about it")


class SceneLinks(BaseModel):
    """Where a scene's parts are."""

    self: str
    ply: str
    files: dict[str, str] = Field(description="by format: ply, compressed.ply, splat, spz")
    preview: str = Field(description="a small film of it")
    sheet: str = Field(description="its inputs drawn again, in one picture")
    views: list[str] = Field(description="pictures from the inputs' cameras")
    inputs: list[str] = Field([], description="the photographs as the scene has them")
    renders: list[str] = Field([], description="those that were asked for with `views`")


class SceneSummary(BaseModel):
    """A line of the list."""

    id: str
    created: str | None
    gaussians: int | None
    views: int
    file: str | None = Field(None, description="format of the file that it was loaded from, if it was")
    links: SceneLinks


class SceneList(BaseModel):
    """Newest first."""

    model_config = _with({"scenes": [], "next": None})
    scenes: list[SceneSummary]
    next: str | None = Field(description="`after` of the following page")


class LoadedFile(BaseModel):
    """The file that a scene was loaded from."""

    format: FormatName
    bytes: int
    sha256: str
    rows: int = Field(description="before invalid ones were dropped")


class SceneDocument(BaseModel):
    """What was computed, from what, how long it took, how far to trust it; docs/scene-document.md has all members."""

    model_config = _with(
        {
            "id": _SCENE, "created": "2026-01-31T12:00:00+00:00", "model": {"preset": "tiny"}, "near": 1.0, "far": 10.0,
            "cameras": [], "view_cameras": [], "gaussians": {"count": 131072, "sh_degree": 0, "added": 5000},
            "warnings": [],
            "check": {}, "timings": {"network": 0.6},
            "links": {
                "self": f"/scenes/{_SCENE}", "ply": f"/scenes/{_SCENE}.ply",
                "files": {"splat": f"/scenes/{_SCENE}.splat"}, "preview": f"/scenes/{_SCENE}/preview",
                "sheet": f"/scenes/{_SCENE}/sheet", "views": [],
            },
        },
        more=True,
    )  # fmt: skip
    id: str
    created: str
    model: dict[str, Any] | None = Field(description="null where no network made it: it was loaded from a file")
    file: LoadedFile | None = Field(None, description="where it was loaded from, if it was")
    near: float
    far: float
    cameras: list[dict[str, Any]]
    view_cameras: list[dict[str, Any]]
    gaussians: dict[str, Any]
    warnings: list[dict[str, Any]]
    check: dict[str, Any] = Field({}, description="of a reconstruction")
    timings: dict[str, float]
    links: SceneLinks


class UnderstoodImage(BaseModel):
    """A photograph with the camera that belongs to it."""

    name: str
    width: int = Field(description="px, turned as EXIF says where the camera is")
    height: int = Field(description="px, likewise")
    camera: dict[str, Any] = Field(description="px and camera to world, OpenCV axes, as in cameras.json")
    thumbnail: str = Field(description="a small JPEG, base64")


class Understood(BaseModel):
    """What was taken for what."""

    images: list[UnderstoodImage]
    paired_by: str
    selection: dict[str, Any] = Field(description="which of the views that were sent, and by what they were chosen")
    near: float
    far: float
    depth_range_source: str = Field(
        description="given, or cameras: estimated from them, before a reconstruction narrows it by the photographs"
    )
    warnings: list[dict[str, Any]]


class Step(BaseModel):
    """A step of the work."""

    stage: str
    done: int
    total: int
    seconds: float = Field(0.0, description="where the stage has ended")


class JobLinks(BaseModel):
    """Where to follow a job."""

    self: str
    events: str
    scene: str = Field("", description="where it is done")


class Job(BaseModel):
    """A reconstruction that is, was or will be computed."""

    model_config = _with(
        {
            "id": _JOB, "state": "queued", "created": "2026-01-31T12:00:00.000+00:00", "started": None, "ended": None,
            "attempts": 0, "ahead": 2, "stage": None,
            "links": {"self": f"/jobs/{_JOB}", "events": f"/jobs/{_JOB}/events"},
        }
    )  # fmt: skip
    id: str
    state: Literal["queued", "running", "done", "failed", "cancelled"]
    created: str
    started: str | None
    ended: str | None
    attempts: int = Field(ge=0)
    ahead: int = Field(ge=0, description="jobs that run or wait before it")
    stage: Step | None = Field(description="where it is, while it runs")
    problem: Problem | None = Field(None, description="why it failed or was cancelled")
    images: list[str] = Field([], description="this and the next three in the answer to the request alone: file names")
    paired_by: str = Field("", description="how cameras were found for them")
    selection: dict[str, Any] = Field({}, description="which views are used")
    warnings: list[dict[str, Any]] = Field([], description="of what was sent; those of the scene are in its document")
    links: JobLinks


class Alive(BaseModel):
    """The process answers."""

    status: Literal["ok"]


class MadeBy(BaseModel):
    """What computes a model: runtime, its version, and the precision of the computation."""

    name: str
    version: str
    precision: Literal["fp32", "bf16"]


class Model(BaseModel):
    """A network that a request may name."""

    name: str
    preset: str
    weights_sha256: str
    file_sha256: str
    width: int = Field(description="px, of every view")
    height: int = Field(description="px, of every view")
    precision: str = Field(description="of the weights")
    licence: str
    engine: MadeBy
    bytes: int = Field(description="of graph and weights, what counts for the budget")
    loaded: bool = Field(description="in the memory of the process that answers")


class ModelList(BaseModel):
    """The default one first."""

    models: list[Model]
    default: str
    loaded_bytes: int
    budget_bytes: int | None
    max_detail: int = Field(description="the most `detail` that a request may ask for")


class Ready(BaseModel):
    """What was loaded, and how long that took."""

    status: Literal["ready"]
    model: Model = Field(description="the default one")
    loaded: dict[str, bool] = Field(description="every model by name")
    timings: dict[str, float]
