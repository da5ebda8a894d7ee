"""Captures in Python: the same scenes, documents and errors as those of the command line."""

from __future__ import annotations

import inspect
import json
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from capture_scenes import arc, write_colmap
from cli_runs import reconstruct

from gapmes.service import Budget, GapmesError, Reconstructor, from_capture, reconstruct_capture, write_ply
from gapmes.service.errors import (
    BaselineError,
    CaptureError,
    DepthRangeError,
    ImageError,
    InputError,
    ViewCountError,
    ViewError,
)
from gapmes.service.network.engine import Engine
from gapmes.service.options import checked_options
from gapmes.service.progress import Stage


@pytest.fixture(scope="module")
def colmap(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("project")
    write_colmap(folder, arc(3))
    return folder


@pytest.fixture(scope="module")
def loaded(engine: Engine) -> Reconstructor:
    return Reconstructor(engine)


def test_the_scene_is_that_of_the_command_line(
    colmap: Path, standin_model: Path, loaded: Reconstructor, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    heard: list[Stage] = []
    scene = reconstruct_capture(colmap, views=[0, 2], trust_poses=True, reconstructor=loaded, listener=heard.append)
    write_ply(tmp_path / "own.ply", scene.gaussians, positions=scene.positions)
    assert reconstruct(colmap, standin_model, "--views", "0,2", "--trust-poses", "--json") == 0
    theirs = json.loads(capfd.readouterr().out)
    assert (tmp_path / "own.ply").read_bytes() == Path(theirs["file"]).read_bytes()
    own = json.loads(json.dumps(scene.document))
    about_the_file = {"file", "format", "notes", "selected_views"}
    assert set(theirs) - set(own) == about_the_file
    timed = {"timings", "pruning"}  # seconds are in both
    assert {name: theirs[name] for name in set(own) - timed} == {name: own[name] for name in set(own) - timed}
    assert own["selection"]["views"] == [0, 2]
    assert {stage.name for stage in heard} > {"read images", "network"}
    assert repr(scene) == f"<Scene of {len(scene.gaussians)} Gaussians from 2 photographs>"


@pytest.mark.parametrize("views", ["0,2", [0, 2], (np.int64(0), "2"), ["view 0000.png", "left side/view 0002.png"]])
def test_views_are_named_by_a_text_or_in_a_sequence(colmap: Path, loaded: Reconstructor, views: Any) -> None:
    scene = reconstruct_capture(str(colmap), views=views, trust_poses=True, reconstructor=loaded, fade=0)
    assert scene.document["selection"]["views"] == [0, 2]


def test_what_the_capture_is_warned_about_is_in_the_document(tmp_path: Path, loaded: Reconstructor) -> None:
    write_colmap(tmp_path, arc(3))
    write_colmap(tmp_path, arc(2), "sparse/1")
    scene = reconstruct_capture(tmp_path, context=2, trust_poses=True, reconstructor=loaded, fade=0)
    assert scene.document["warnings"][0]["code"] == "several_models"
    assert scene.document["selection"]["by"] == "score"


@pytest.mark.parametrize(
    ("options", "kind", "field"),
    [
        ({"views": 3}, InputError, "views"),
        ({"views": [0]}, ViewCountError, "views"),
        ({"views": []}, ViewCountError, "views"),
        ({"views": ["0,1"]}, ViewError, "views"),
        ({"views": [0, 7]}, ViewError, "views"),
        ({"views": [0, 1], "context": 2}, InputError, "context"),
        ({"context": "2"}, InputError, "context"),
        ({"context": 7}, ViewCountError, "context"),
        ({"near": "1", "far": 9}, DepthRangeError, "near"),
        ({"context": 2, "near": 1, "far": float("nan")}, DepthRangeError, "far"),
        ({"detail": 3}, InputError, "detail"),
    ],
)
def test_wrong_arguments_are_named(
    colmap: Path, loaded: Reconstructor, options: dict[str, Any], kind: type[GapmesError], field: str
) -> None:
    with pytest.raises(kind) as caught:
        reconstruct_capture(colmap, reconstructor=loaded, **options)
    assert caught.value.field == field


@pytest.mark.parametrize("path", [None, 5, b"project", ["project"]])
def test_what_is_no_path_is_named(path: Any) -> None:
    with pytest.raises(InputError) as caught:
        reconstruct_capture(path)
    assert (caught.value.field, caught.value.message) == ("path", f"is a {type(path).__name__}, need a path")
    assert caught.value.cure == "give a folder, a .zip or a camera file"


def test_a_reconstructor_is_one(colmap: Path) -> None:
    with pytest.raises(InputError, match="reconstructor: is a str, need a Reconstructor"):
        reconstruct_capture(colmap, reconstructor=cast(Any, "tiny.onnx"))


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"budget": 0.1}, "budget"),
        ({"leave_one_out": 1}, "leave_one_out"),
        ({"fade": 9}, "fade"),
        ({"detail": 3}, "detail"),
        ({"detail": 2, "budget": Budget(stride=2)}, "detail"),
        ({"trust_poses": "no"}, "trust_poses"),
        ({"refine_poses": 1}, "refine_poses"),
        ({"whole": None}, "whole"),
        ({"faed": 1}, None),
        ({"numbers": [0, 1]}, None),  # are the capture's
        ({"near": 5.0, "far": 2.0}, "near"),
        ({"near": 2.0}, "far"),  # which the capture lacks
    ],
)
def test_wrong_options_are_refused_before_the_network_is_loaded(
    colmap: Path, monkeypatch: pytest.MonkeyPatch, options: dict[str, Any], field: str | None
) -> None:
    loads: list[object] = []
    monkeypatch.setattr(from_capture, "Reconstructor", loads.append)
    with pytest.raises(TypeError if field is None else InputError) as caught:
        reconstruct_capture(colmap, **options)
    assert loads == []
    assert getattr(caught.value, "field", None) == field
    unknown = f"reconstruct_capture() got an unexpected keyword argument {next(iter(options))!r}"
    assert field is not None or str(caught.value) == unknown


@pytest.mark.parametrize(
    ("views", "error"), [(1, ViewCountError), (2, BaselineError)], ids=["one view", "all at one place"]
)
def test_captures_without_parallax_are_refused_before_the_network_is_loaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, views: int, error: type[InputError]
) -> None:
    write_colmap(tmp_path, [arc(1)[0]] * views)
    loads: list[object] = []
    monkeypatch.setattr(from_capture, "Reconstructor", loads.append)
    with pytest.raises(error):
        reconstruct_capture(tmp_path)
    assert loads == []


def test_the_defaults_are_those_of_the_reconstructor() -> None:
    own, its = (inspect.signature(each).parameters for each in (checked_options, Reconstructor.reconstruct))
    assert {name: one.default for name, one in own.items()} == {name: its[name].default for name in own}


def test_a_photograph_that_cannot_be_read_is_named_by_its_place_in_the_capture(
    tmp_path: Path, loaded: Reconstructor
) -> None:
    write_colmap(tmp_path, arc(3))
    (tmp_path / "images/left side/view 0002.png").write_bytes(b"GIF89a")
    with pytest.raises(ImageError) as caught:
        reconstruct_capture(tmp_path, views=[1, 2], reconstructor=loaded)
    assert caught.value.index == 2
    with pytest.raises(CaptureError, match="does not exist"):
        reconstruct_capture(tmp_path / "elsewhere", reconstructor=loaded)
