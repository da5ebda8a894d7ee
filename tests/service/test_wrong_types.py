"""The public functions with arguments of another type: a refusal that names the argument and what is needed."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from plane_scene import PlaneScene

from gapmes.service import (
    Budget,
    Camera,
    GapmesError,
    Gaussians,
    InputError,
    Photo,
    Reconstructor,
    inspect_ply,
    read_gaussians,
    read_ply,
    render,
    render_reference,
    write_gaussians,
    write_ply,
)
from gapmes.service.arguments import shown
from gapmes.service.errors import GaussiansError, ImageError, ModelError, PoseError
from gapmes.service.formats.ply_write import ply_bytes
from gapmes.service.network.engine import Engine
from gapmes.service.progress import Stage
from gapmes.service.splat import render_supersampled

ONE = Gaussians.make([[0, 0, 2]], [[0.1, 0.1, 0.1]], [[1, 0, 0, 0]], [0.5], [[[0.5, 0.5, 0.5]]])
CAMERA = Camera.make(32, 32, 32, 32, 16, 16, np.eye(4))
FIELDS = ("means", "scales", "rotations_wxyz", "opacities", "harmonics")


class Gradient:
    """Refuses to become an array, as a torch tensor with a gradient does."""

    def __array__(self, *_: object, **__: object) -> Any:
        raise RuntimeError("use detach()")


def _refusal(call: Callable[[], object], kind: type[GapmesError] = InputError) -> GapmesError:
    with pytest.raises(kind) as caught:
        call()
    return caught.value


@pytest.mark.parametrize("name", FIELDS)
@pytest.mark.parametrize("value", ["abc", {}, object(), [[1, 2], [1]], [["1"]], Gradient(), np.ones((1, 3), complex)])
@pytest.mark.filterwarnings("error")
def test_a_field_of_gaussians_that_is_no_numbers_is_named(name: str, value: object) -> None:
    given = {field: getattr(ONE, field) for field in FIELDS} | {name: value}
    error = _refusal(lambda: Gaussians.make(**given), GaussiansError)
    assert error.field == name
    assert f"is a {type(value).__name__} that gives no real numbers" in error.message


@pytest.mark.parametrize(
    ("name", "shape", "need"),
    [
        ("means", (1, 2), "(1, 3)"),
        ("scales", (2, 3), "(1, 3)"),
        ("rotations_wxyz", (1, 3), "(1, 4)"),
        ("opacities", (1, 1), "(1,)"),
        ("harmonics", (1, 3), "(1, 1|4|9|16, 3)"),
        ("harmonics", (2, 1, 3), "(1, 1|4|9|16, 3)"),
        ("harmonics", (1, 5, 3), "(1, 1|4|9|16, 3)"),
        ("harmonics", (1, 1, 4), "(1, 1|4|9|16, 3)"),
    ],
)
def test_a_field_of_gaussians_of_another_shape_is_named(name: str, shape: tuple[int, ...], need: str) -> None:
    given = {field: getattr(ONE, field) for field in FIELDS} | {name: np.ones(shape)}
    error = _refusal(lambda: Gaussians.make(**given), GaussiansError)
    assert (error.field, error.message) == (name, f"shape is {shape}, need {need}")


@pytest.mark.filterwarnings("error")
def test_a_number_beyond_float32_is_refused_without_a_warning_of_numpy() -> None:
    given = {field: getattr(ONE, field) for field in FIELDS} | {"scales": [[1e300, 1, 1]]}
    error = _refusal(lambda: Gaussians.make(**given), GaussiansError)
    assert (error.field, error.index) == ("scales", 0)


def test_a_tuple_of_indices_selects_like_a_list() -> None:
    two = Gaussians(*(np.repeat(getattr(ONE, field), 2, axis=0) for field in FIELDS))
    assert len(two[(1, 0, 1)]) == 3
    with pytest.raises(TypeError, match="2 axes"):
        two[np.zeros((2, 2), int)]


@pytest.mark.parametrize("draw", [render, render_reference, lambda *both: render_supersampled(*both, 2)])
@pytest.mark.parametrize("wrong", [None, "scene.ply", [ONE], CAMERA])
def test_what_is_drawn_and_from_where_is_checked(draw: Callable[..., object], wrong: object) -> None:
    error = _refusal(lambda: draw(wrong, CAMERA))
    assert (error.field, error.message) == ("gaussians", f"is a {type(wrong).__name__}, need a Gaussians")
    if wrong is not CAMERA:
        error = _refusal(lambda: draw(ONE, wrong))
        assert (error.field, error.message) == ("camera", f"is a {type(wrong).__name__}, need a Camera")


@pytest.mark.parametrize("draw", [render, lambda *both, **more: render_supersampled(*both, 2, **more)])
def test_outputs_may_come_from_an_iterator(draw: Callable[..., Any]) -> None:
    found = draw(ONE, CAMERA, outputs=iter(["depth", "alpha"]))
    assert found.alpha.shape == found.depth.shape == (32, 32)
    assert _refusal(lambda: draw(ONE, CAMERA, outputs=5)).field == "outputs"
    assert "7 is unknown" in _refusal(lambda: draw(ONE, CAMERA, outputs=["alpha", 7])).message
    assert "[] is unknown" in _refusal(lambda: draw(ONE, CAMERA, outputs=[[]])).message


@pytest.mark.parametrize("definition", [{}, "inria", 0])
def test_a_definition_is_one(definition: Any) -> None:
    for draw in (render, render_reference):
        assert _refusal(lambda draw=draw: draw(ONE, CAMERA, definition=definition)).field == "definition"


@pytest.mark.parametrize("read", [read_ply, inspect_ply, read_gaussians])
@pytest.mark.parametrize("source", [None, 5, [], np.zeros(9, np.uint8), io.StringIO("ply\n")])
def test_what_gives_no_bytes_is_no_file(read: Callable[[Any], object], source: object) -> None:
    error = _refusal(lambda: read(source))
    assert error.field == "source"
    assert error.message.startswith(f"is a {type(source).__name__}")


def test_an_open_file_may_give_any_bytes() -> None:
    class Mapped(io.BytesIO):
        def read(self, *size: Any) -> Any:
            return memoryview(super().read(*size))

    assert len(read_ply(Mapped(ply_bytes(ONE)))) == 1


def test_formats_and_dialects_are_checked_by_type(tmp_path: Path) -> None:
    data = ply_bytes(ONE)
    for wrong in (5, b"ply", ["ply"]):
        assert _refusal(lambda wrong=wrong: read_gaussians(data, format=wrong)).field == "format"
        error = _refusal(lambda wrong=wrong: write_gaussians(tmp_path / "a.ply", ONE, format=wrong))
        assert error.field == "format"
    for wrong in (None, {}, "logit"):
        assert _refusal(lambda wrong=wrong: read_gaussians(data, dialect=wrong)).field == "dialect"
        assert _refusal(lambda wrong=wrong: inspect_ply(data, dialect=wrong)).field == "dialect"


@pytest.mark.parametrize("wrong", [None, [ONE], "scene.ply", ONE.means])
def test_only_gaussians_are_written(wrong: Any, tmp_path: Path) -> None:
    for name in ("a.ply", "a.spz", "a.splat", "a.compressed.ply"):
        assert _refusal(lambda name=name: write_gaussians(tmp_path / name, wrong)).field == "gaussians"
    assert _refusal(lambda: write_ply(tmp_path / "a.ply", wrong)).field == "gaussians"
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("target", [None, 5, b"a.ply"])
def test_a_ply_is_written_to_a_path_or_an_open_file(target: Any) -> None:
    assert _refusal(lambda: write_ply(target, ONE)).field == "target"


class PathOfBytes:
    """As `os.scandir` gives for a folder named in bytes."""

    def __fspath__(self) -> bytes:
        return b"a.ply"


@pytest.mark.parametrize("path", [None, 5, b"a.ply", ["a.ply"], PathOfBytes()])
def test_files_are_named_by_paths(path: Any) -> None:
    calls: dict[str, Callable[[], object]] = {
        "path": lambda: write_gaussians(path, ONE),
        "prepare": lambda: Reconstructor(threads=1, prepare=path or 0),  # None is no folder, as it is the shipped model
        "model": lambda: Reconstructor(path or 0),
    }
    for field, call in calls.items():
        error = _refusal(call)
        assert (error.field, error.message.partition(", ")[2]) == (field, "need a path")


def test_photographs_and_poses_that_give_no_array_are_refused() -> None:
    for wrong in ([[1], [1, 2]], Gradient()):
        error = _refusal(lambda wrong=wrong: Photo.from_array(wrong, index=3), ImageError)
        assert (error.field, error.index) == ("images", 3)
    for wrong in (None, "a.png", np.zeros((40, 40, 3), np.uint8)):
        error = _refusal(lambda wrong=wrong: Photo.from_image(wrong), ImageError)
        assert error.message.startswith(f"is a {type(wrong).__name__}, need a PIL image")
    assert Photo.from_image(Image.new("RGB", (40, 40))).width == 40
    assert _refusal(lambda: Camera.make(32, 32, 32, 32, 16, 16, Gradient()), PoseError).field == "camera.c2w"


def test_a_network_takes_no_more_threads_than_the_command() -> None:
    error = _refusal(lambda: Reconstructor(threads=1025), ModelError)
    assert error.message == "threads = 1025, need a whole number from 1 to 1024"


def test_the_folder_for_prepared_models_may_be_text(tmp_path: Path) -> None:
    Reconstructor(threads=1, prepare=str(tmp_path / "prepared"))
    assert any((tmp_path / "prepared").iterdir())


@pytest.mark.parametrize("value", ["no", 1, 0, None, [False]])
def test_trust_in_poses_is_true_or_false(value: Any, engine: Engine) -> None:
    error = _refusal(lambda: Reconstructor(engine).reconstruct([], [], trust_poses=value))
    assert (error.field, error.message) == ("trust_poses", f"is {shown(value)}, need True or False")


@pytest.mark.parametrize("view", ["bogus", "3"])
def test_a_certified_view_that_is_none_is_refused_before_the_network(
    view: str, engine: Engine, plane_scene: PlaneScene
) -> None:
    def reconstruct() -> None:
        Reconstructor(engine).reconstruct(
            plane_scene.images, plane_scene.cameras, budget=Budget(asked=(view,)), listener=begun.append
        )

    begun: list[Stage] = []
    assert _refusal(reconstruct).field == "budget.asked"
    assert {stage.name for stage in begun} == {"cameras"}
