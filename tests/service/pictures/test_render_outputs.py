"""`gapmes render` as a user runs it: films, contact sheets and depth, and its refusals before drawing."""

from __future__ import annotations

import json
import os
import re
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from capture_scenes import arc, write_colmap
from cli_runs import assert_refusal, run
from clouds import cloud
from PIL import Image, ImageSequence
from test_film import decoded, planes
from typer.main import get_command

from gapmes.service.captures.capture import read_camera_file
from gapmes.service.cli import app
from gapmes.service.formats.ply import read_ply, write_ply
from gapmes.service.pictures.effort import draw
from gapmes.service.pictures.picture_error import psnr
from gapmes.service.viewpoints.camera_path import loop
from gapmes.service.viewpoints.scene_views import SceneViews


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A scene of a few hundred Gaussians, and three cameras of odd size that look at it."""
    write_ply(tmp_path / "scene.ply", cloud(300, 3, degree=0))
    views = []
    for index in range(3):
        pose = np.eye(4)
        pose[0, 3] = 0.2 * index
        camera = {"width": 95, "height": 63, "fx": 80.0, "fy": 80.0, "cx": 47.5, "cy": 31.5}
        views.append(camera | {"c2w": pose.tolist()})
    (tmp_path / "cameras.json").write_text(json.dumps({"near": 1.0, "far": 10.0, "views": views}))
    return tmp_path


def render(folder: Path, output: str, *more: object) -> int:
    arguments = ("--cameras", folder / "cameras.json", "-o", folder / output, "--threads", 1)
    return run("render", folder / "scene.ply", *arguments, *more)


def shown(path: Path, frames: int, seconds: float) -> list[np.ndarray]:
    """What a player shows in the middle of each frame's time: WebP keeps equal neighbours as one, for longer."""
    found = decoded(path)
    if path.suffix == ".mp4":
        assert len(found) == frames
        return found
    with Image.open(path) as image:
        times = []
        for frame in ImageSequence.Iterator(image):
            frame.load()
            times.append(frame.info["duration"])
    ends = np.cumsum(times)
    assert ends[-1] == round(1000 * seconds)
    middles = (np.arange(frames) + 0.5) * ends[-1] / frames
    return [found[index] for index in np.searchsorted(ends, middles)]


FORMATS = ["webp", "gif", pytest.param("mp4", marks=pytest.mark.skipif(find_spec("av") is None, reason="[video]"))]


@pytest.mark.parametrize("format", FORMATS)
@pytest.mark.parametrize("path", ["turntable", "inputs", "orbit"])
def test_a_film_shows_its_path(folder: Path, format: str, path: Any, capfd: pytest.CaptureFixture[str]) -> None:
    assert render(folder, f"film.{format}", "--path", path, "--seconds", 0.5, "--fps", 12, "--json") == 0
    film = json.loads(capfd.readouterr().out)["film"]
    size = (94, 62) if format == "mp4" else (95, 63)  # MP4 has even sides
    assert (film["width"], film["height"], film["frames"], film["path"]) == (*size, 6, path)
    file = read_camera_file(folder / "cameras.json")
    views = SceneViews(file.cameras, file.near, file.far)
    gaussians = read_ply(folder / "scene.ply")
    frames = shown(folder / f"film.{format}", 6, 0.5)
    for found, camera in zip(frames, loop(views.path(path), 6), strict=True):
        expected = draw(gaussians, camera, threads=1, **views.near_plane).rgb8()
        cut = expected[: size[1], : size[0]] if format == "mp4" else expected
        # measured at worst: 26.6 in MP4, 32.4 in WebP, 34.3 in GIF; another frame of the path has at most 18.9
        assert psnr(planes(found), planes(cut)) > 25.5


def test_a_turntable_is_what_a_film_shows_unasked(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    options = ("--seconds", 0.4, "--fps", 10, "--views", "0,2", "--size", "40x30", "--json")
    assert render(folder, "film.webp", *options) == 0
    film = json.loads(capfd.readouterr().out)["film"]
    assert film["path"] == "turntable"
    assert [frame.shape for frame in shown(folder / "film.webp", 4, 0.4)] == [(30, 40, 3)] * 4


@pytest.mark.parametrize(
    ("seconds", "fps", "frames", "told"),
    [
        (0.15, 50, 7, "7 frames in 0.15 s are 46.67 per second, not 50"),  # 8 would be more than 50
        (0.5, 7.3, 4, "4 frames in 0.5 s are 8 per second, not 7.3"),
        (0.4, 10, 4, None),
        (0.14, None, 3, None),  # no rate was asked for
    ],
)
def test_whole_frames_at_another_rate_than_was_asked_for_are_told(
    folder: Path, seconds: float, fps: float | None, frames: int, told: str | None, capfd: pytest.CaptureFixture[str]
) -> None:
    rate = () if fps is None else ("--fps", fps)
    assert render(folder, "film.gif", "--seconds", seconds, *rate, "--size", "24x16", "--json") == 0
    document = json.loads(capfd.readouterr().out)
    assert (document["film"]["frames"], document["film"]["fps"]) == (frames, pytest.approx(frames / seconds))
    assert document["warnings"] == ([] if told is None else [told])


@pytest.mark.parametrize("name", ["sheet.png", "sheet.jpg", "sheet.webp"])
def test_a_sheet_has_every_view(folder: Path, name: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert render(folder, name, "--sheet", "--views", "0,1.5,orbit:5", "--json") == 0
    sheet = json.loads(capfd.readouterr().out)["sheet"]
    assert sheet["views"] == ["0", "1.5", "orbit:5"]
    with Image.open(folder / name) as image:
        assert image.size == (sheet["width"], sheet["height"])
        assert image.format == {"png": "PNG", "jpg": "JPEG", "webp": "WEBP"}[name.split(".")[1]]


def test_depth_at_a_given_scale(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """16 bits; half a level at most from the depths that are drawn."""
    assert render(folder, "views", "--channel", "depth", "--depth-scale", 0.001, "--views", "1", "--json") == 0
    (entry,) = json.loads(capfd.readouterr().out)["views"]
    assert (entry["depth_scale"], entry["depth_offset"]) == (0.001, 0.0)
    file = read_camera_file(folder / "cameras.json")
    views = SceneViews(file.cameras, file.near, file.far)
    drawn = draw(read_ply(folder / "scene.ply"), file.cameras[1], "depth", threads=1, **views.near_plane)
    with Image.open(entry["file"]) as image:
        levels = np.asarray(image).astype(np.float64)
    there = drawn.alpha > 0
    assert levels.max() > 255
    assert np.abs(0.001 * levels - drawn.depth)[there].max() <= 0.0005001
    assert not levels[~there].any()
    assert render(folder, "views", "--channel", "depth", "--depth-scale", 1e-6, "--json") == 1
    assert "65535" in assert_refusal(capfd, "depth_scale")["detail"]


PAGE = (Path(__file__).parents[3] / "docs" / "rendering.md").read_text(encoding="utf-8")


def test_the_page_names_options_that_exist_and_every_one_of_a_film() -> None:
    known = {option for parameter in get_command(app).commands["render"].params for option in parameter.opts}  # type: ignore[attr-defined]
    named = set(re.findall(r"(?<!\S)`?(--[a-z-]+)", PAGE))
    assert named <= known
    assert {"--path", "--swing", "--seconds", "--fps", "--sheet", "--depth-scale"} <= named


def test_the_page_names_all_that_a_picture_counts(folder: Path) -> None:
    stats = draw(read_ply(folder / "scene.ply"), read_camera_file(folder / "cameras.json").cameras[0], threads=1).stats
    assert [name for name in (*stats, *stats["culled"], *stats["seconds"]) if f"`{name}`" not in PAGE] == []


def test_depth_is_read_as_the_page_says(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert render(folder, "views", "--channel", "depth", "--views", "0", "-q") == 0
    (snippet,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    monkeypatch.chdir(folder / "views")
    names: dict[str, Any] = {}
    exec(snippet, names)
    file = read_camera_file(folder / "cameras.json")
    near = SceneViews(file.cameras, file.near, file.far).near_plane
    drawn = draw(read_ply(folder / "scene.ply"), file.cameras[0], "depth", threads=1, **near)
    np.testing.assert_array_equal(np.isnan(names["depth"]), drawn.alpha == 0)
    there = drawn.alpha > 0
    span = float(drawn.depth[there].max() - drawn.depth[there].min())
    assert np.abs(names["depth"] - drawn.depth)[there].max() <= 0.5001 * span / 65534


MANY = ",".join(f"orbit:{number}" for number in range(307))


@pytest.mark.parametrize(
    ("output", "options", "words"),
    [
        ("views", ("--path", "orbit"), "path: goes with a film, and 'views' is none"),
        ("views", ("--seconds", 2), "seconds: goes with a film"),
        ("film.avi", ("--fps", 20), "fps: goes with a film"),
        ("film.webp", ("--channel", "depth"), "channel: a film shows rgb, not depth"),
        ("film.webp", ("--path", "orbit", "--swing", 20), "swing: goes with the path turntable"),
        ("film.webp", ("--path", "inputs", "--views", "1"), "path: 1 place of a camera is no path"),
        ("film.webp", ("--seconds", 0.1, "--fps", 1), "frames: 0 is no film"),
        ("film.mp4", ("--size", "33x32"), "width: 33 px, MP4 needs an even number"),
        ("film.webp", ("--size", "16384x10"), "width: 16384 px, the limit of webp is 16383"),
        ("no/folder/film.webp", (), "is not a folder"),
        ("sheet.gif", ("--sheet",), "sheet: is one file, and 'sheet.gif' does not end in one of .png, .jpg"),
        ("sheet", ("--sheet",), "/sheet.png)"),
        ("sheet.webp", ("--sheet", "--fps", 20), "fps: goes with a film, and 'sheet.webp' is a sheet"),
        ("sheet.png", ("--sheet", "--channel", "alpha"), "channel: a sheet shows rgb, not alpha (leave it out)"),
        (
            "sheet.webp",
            ("--sheet", "--size", "400x400", "--views", MANY),
            "sheet: height of 307 views is 16652 px, the limit of webp is 16383 (write .png, or fewer --views)",
        ),
        (
            "sheet.jpg",
            ("--sheet", "--size", "256x256", "--views", ",".join(f"orbit:{n / 10}" for n in range(1225))),
            "sheet: height of 1225 views is 65612 px, the limit of jpeg is 65500",
        ),
        ("views", ("--depth-scale", 0.1), "depth_scale: goes with channel depth, not with rgb"),
    ],
)
def test_refusals_before_the_work(
    folder: Path, output: str, options: tuple[object, ...], words: str, capfd: pytest.CaptureFixture[str]
) -> None:
    (folder / "scene.ply").unlink()  # it is not looked at
    assert render(folder, output, *options, "--json") == 1
    assert_refusal(capfd, words)
    assert sorted(path.name for path in folder.iterdir()) == ["cameras.json"]


@pytest.mark.parametrize(
    ("bounds", "words"),
    [
        ({"near": 1.0}, "far is missing"),
        ({"far": 9.0}, "near is missing"),
        ({"near": -1.0}, "far is missing"),
        ({"near": 0.0, "far": 5.0}, "near = 0, need a finite depth above 0"),
    ],
)
def test_bounds_are_refused_as_by_a_reconstruction(
    folder: Path, bounds: dict[str, float], words: str, capfd: pytest.CaptureFixture[str]
) -> None:
    cameras = json.loads((folder / "cameras.json").read_text())
    (folder / "cameras.json").write_text(json.dumps({"views": cameras["views"], **bounds}))
    assert render(folder, "views", "--json") == 1
    assert assert_refusal(capfd, words)["code"] == "depth_range_invalid"


def test_what_was_drawn_is_counted(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert render(folder, "views", "--views", "0,1", "--json") == 0
    document = json.loads(capfd.readouterr().out)
    assert document["warnings"] == []
    for entry in document["views"]:
        stats = entry["stats"]
        assert stats["projected"] > 100
        assert stats["count"] == stats["projected"] + sum(stats["culled"].values()) == 300
        assert stats["crossing_near"] == 0
    assert render(folder, "sheet.png", "--sheet", "--views", "0,1", "--json") == 0
    stats = json.loads(capfd.readouterr().out)["sheet"]["stats"]
    assert [one["count"] for one in stats] == [300, 300]
    assert render(folder, "film.webp", "--seconds", 0.4, "--fps", 10, "--json") == 0
    least, most = json.loads(capfd.readouterr().out)["film"]["projected"]
    assert 100 < least <= most <= 300


@pytest.mark.parametrize(
    ("output", "options", "named"),
    [
        ("views", (), "view 0, view 1, view 2"),
        ("sheet.png", ("--sheet", "--views", "2,0.5"), "view 2, view 0.5"),
        ("film.gif", ("--seconds", 0.6, "--fps", 10), "frame 0, frame 1, frame 2, frame 3, frame 4 and 1 more"),
    ],
)
def test_pictures_of_nothing_are_told(
    folder: Path, output: str, options: tuple[object, ...], named: str, capfd: pytest.CaptureFixture[str]
) -> None:
    """Cameras in millimetres where the scene is in metres."""
    cameras = json.loads((folder / "cameras.json").read_text())
    (folder / "cameras.json").write_text(json.dumps(cameras | {"near": 1000.0, "far": 10000.0}))
    assert render(folder, output, *options, "--json") == 0
    out, err = capfd.readouterr()
    (told,) = json.loads(out)["warnings"]
    assert told.startswith(
        f"{named}: none of 300 Gaussians is drawn ({named.split(', ')[0]}: 300 before the near plane"
    )
    assert "at z-depth 100; do scene and cameras have the same unit" in told
    assert f"warning: {told}" in err


def test_why_nothing_is_drawn(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Without near and far, behind the camera; and fainter than what is asked to be drawn."""
    cameras = json.loads((folder / "cameras.json").read_text())
    back = {**cameras["views"][0], "c2w": np.diag([1.0, -1.0, -1.0, 1.0]).tolist()}
    (folder / "back.json").write_text(json.dumps({"views": [back]}))
    assert render(folder, "views", "--cameras", folder / "back.json", "--json") == 0
    (told,) = json.loads(capfd.readouterr().out)["warnings"]
    assert "300 before the near plane at z-depth 0.01; do scene" in told
    faint = cloud(300, 3, degree=0)
    write_ply(folder / "scene.ply", replace(faint, opacities=np.full(300, 0.5, np.float32)))
    assert render(folder, "views", "--views", "0", "--alpha-min", 0.6, "--json") == 0
    told = json.loads(capfd.readouterr().out)["warnings"][-1]
    assert told.endswith("fainter than alpha_min; lower --alpha-min)")


def test_a_radius_cuts_the_pictures_splats(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    for name, options in (("whole", ()), ("same", ("--cut-radius", 6)), ("cut", ("--cut-radius", 1.5))):
        assert render(folder, name, "--views", "0", *options) == 0
    whole, same, cut = ((folder / name / "view_0.png").read_bytes() for name in ("whole", "same", "cut"))
    assert whole == same != cut
    capfd.readouterr()
    assert render(folder, "none", "--cut-radius", 0.5) == 1
    assert "cut_radius: is 0.5, need 1 to 6" in capfd.readouterr().err


def test_other_models_of_the_cameras_are_told(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write_colmap(folder / "project", arc(2))
    write_colmap(folder / "project", arc(3), "sparse/1")
    arguments = ("-o", folder / "views", "--threads", 1, "--json")
    assert run("render", folder / "scene.ply", "--cameras", folder / "project", *arguments) == 0
    out, err = capfd.readouterr()
    assert len(json.loads(out)["views"]) == 3
    assert "warning: 2 COLMAP models are there: sparse/1 (3 images) is read; ignored: sparse/0 (2 images)" in err
    assert run("render", folder / "scene.ply", "--cameras", folder / "project/sparse/0/images.bin", *arguments) == 0
    document = json.loads(capfd.readouterr().out)
    assert len(document["views"]) == 2
    assert not any("COLMAP" in warning for warning in document["warnings"])


@pytest.mark.parametrize(("output", "options"), [("views", ()), ("film.gif", ()), ("sheet.png", ("--sheet",))])
def test_where_nothing_may_be_written(
    folder: Path, output: str, options: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    monkeypatch.setattr(os, "access", lambda _, mode: not mode & os.W_OK)
    (folder / "scene.ply").unlink()  # it is not looked at
    assert render(folder, output, *options, "--json") == 1
    error = assert_refusal(capfd, "no permission")
    assert (error["field"], error["code"]) == ("output", "invalid_input")
    assert error["cure"]
