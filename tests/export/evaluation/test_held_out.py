"""Held-out views of captures that suggest none: the rule against its definition, and captures of every format."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from capture_scenes import arc, names, write_cameras_json, write_colmap, write_llff, write_transforms
from evaluate_runs import refused, run
from numpy.testing import assert_allclose, assert_array_equal
from standin_model import METADATA, write_standin

from gapmes.export.evaluation.case import photograph_case
from gapmes.export.evaluation.held_out import held_out_views
from gapmes.export.evaluation.report import Report
from gapmes.export.evaluation.scene_views import HELD_OUT, scene_views
from gapmes.export.evaluation.suggested import NoSuchViews
from gapmes.service.cameras.camera import Camera
from gapmes.service.captures.choose import chosen_views
from gapmes.service.errors import ImageError
from gapmes.service.photographs.fitting import fitted
from gapmes.service.photographs.images import EncodedPhoto


def row(places: np.ndarray) -> list[Camera]:
    """Cameras side by side at these places, in units of the depth of what they look at, which is 1."""
    cameras = []
    for place in places:
        pose = np.eye(4)
        pose[0, 3] = place
        cameras.append(Camera.make(96, 72, 80.0, 80.0, 48.0, 36.0, pose))
    return cameras


def angle(one: Camera, other: Camera, depth: float) -> float:
    """Parallax in radians, mean of what the two look at."""
    found = []
    for camera in (one, other):
        point = camera.center + depth * camera.rotation[:, 2]
        a, b = one.center - point, other.center - point
        found.append(np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1)))
    return float(np.mean(found))


def share(target: Camera, inputs: list[Camera], depth: float) -> float:
    """Of a 5 x 5 grid of the target, at its depth, that at least one of the inputs shows."""
    seen = 0
    for down in (np.arange(5) + 0.5) / 5 * target.height:
        for across in (np.arange(5) + 0.5) / 5 * target.width:
            ray = np.array([(across - target.cx) / target.fx, (down - target.cy) / target.fy, 1.0])
            point = target.center + depth * target.rotation @ ray
            for camera in inputs:
                x, y, z = camera.rotation.T @ (point - camera.center)
                u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
                if z > 0 and 0 <= u < camera.width and 0 <= v < camera.height:
                    seen += 1
                    break
    return seen / 25


@pytest.mark.parametrize("inputs", [2, 3])
@pytest.mark.parametrize("seed", range(6))
def test_the_rule_is_the_definition(seed: int, inputs: int) -> None:
    """View by view, in cameras that wander along a path."""
    rng = np.random.default_rng(seed)
    cameras = row(np.cumsum(rng.uniform(0.02, 0.2, 14)))
    for camera in cameras:
        camera.world_from_cam[1, 3] += rng.normal(scale=0.03)
    given, targets = held_out_views(cameras, [1.0] * 14, inputs)
    kept = cameras[::2]
    assert given == [2 * place for place in chosen_views(kept, inputs, [1.0] * 7).places]
    chosen = [cameras[i] for i in given]
    most = max(angle(a, b, 1.0) for a in chosen for b in chosen)
    nearest = {i: min(angle(cameras[i], camera, 1.0) for camera in chosen) for i in range(1, 14, 2)}
    allowed = [i for i in nearest if nearest[i] <= 0.6 * most and share(cameras[i], chosen, 1.0) >= 0.9]
    expected: list[int] = []
    while len(expected) < 4 and len(expected) < len(allowed):
        left = [i for i in allowed if i not in expected]
        gaps = [min([nearest[i], *(angle(cameras[i], cameras[j], 1.0) for j in expected)]) for i in left]
        expected.append(left[int(np.argmax(gaps))])
    assert targets == sorted(expected)
    assert targets


def test_of_a_film_targets_are_spread_between_the_inputs() -> None:
    """Of 401 frames whose neighbours hardly differ, not four beside each other, and none beside an input."""
    (first, last), targets = held_out_views(row(np.linspace(0.0, 2.0, 401)), [1.0] * 401, 2)
    assert len(targets) == 4
    gaps = np.diff(sorted([first, last, *targets]))
    assert gaps.min() > 0.15 * (last - first)
    assert all(target % 2 for target in targets)


def test_too_few_views_hold_out_no_target() -> None:
    for count, inputs in ((2, 2), (3, 3), (4, 3)):
        assert held_out_views(arc(count), [None] * count, inputs)[1] == []
    assert held_out_views(arc(3), [None] * 3, 2) == ([0, 2], [1])
    still = held_out_views(row(np.zeros(8)), [1.0] * 8, 2)  # from one place: nothing lies between
    assert still[1] == []


WRITERS = {
    "colmap": write_colmap,
    "transforms": write_transforms,
    "llff": write_llff,
    "cameras.json": write_cameras_json,
}


@pytest.mark.parametrize("kind", WRITERS)
def test_captures_of_every_format_hold_out_views(tmp_path: Path, kind: str) -> None:
    WRITERS[kind](tmp_path / "capture", arc(7))
    found = scene_views(tmp_path / "capture", 2)
    assert found.by == HELD_OUT
    assert set(found.inputs.indices) <= {0, 2, 4, 6}
    assert found.targets.indices
    assert set(found.targets.indices) <= {1, 3, 5}
    case = photograph_case(tmp_path / "capture", 2, 64, 64)
    assert case.photographs == found.said
    assert (len(case.photos), len(case.targets)) == (2, len(found.targets.indices))
    if kind == "llff":  # the bounds of the two inputs
        assert_allclose((case.near, case.far), (2.0 - 0.1 * max(found.inputs.indices), 9.0 + max(found.inputs.indices)))


def test_a_zip_is_measured_as_its_folder(tmp_path: Path) -> None:
    write_colmap(tmp_path / "capture", arc(5))
    with zipfile.ZipFile(tmp_path / "capture.zip", "w") as archive:
        for path in sorted((tmp_path / "capture").rglob("*")):
            archive.write(path, path.relative_to(tmp_path / "capture"))
    folder, packed = (photograph_case(tmp_path / name, 2, 64, 64) for name in ("capture", "capture.zip"))
    assert folder.photographs == packed.photographs
    for one, other in zip(folder.targets, packed.targets, strict=True):
        assert_array_equal(one.image, other.image)


def test_photographs_through_a_lens_are_those_of_a_reconstruction(tmp_path: Path) -> None:
    write_transforms(tmp_path, arc(5))
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"k1": -0.2, "k2": 0.05}))
    views = scene_views(tmp_path, 2)
    case = photograph_case(tmp_path, 2, 64, 64)
    for place, view in enumerate(views.inputs.file.views):
        assert view.lens is not None
        photo = EncodedPhoto(views.inputs.read(place), lens=view.lens)
        theirs = fitted(photo, view.camera, place, (64, 64))[0]
        assert_array_equal(case.inputs[place].image, theirs.image)
        assert_array_equal(case.inputs[place].camera.intrinsics, theirs.camera.intrinsics)


def test_a_spoilt_photograph_in_a_zip_is_named(tmp_path: Path) -> None:
    write_colmap(tmp_path / "capture", arc(5))
    first = scene_views(tmp_path / "capture", 2).targets.paths[0]
    with zipfile.ZipFile(tmp_path / "capture.zip", "w") as archive:
        for path in sorted(each for each in (tmp_path / "capture").rglob("*") if each.is_file()):
            name = path.relative_to(tmp_path / "capture").as_posix()
            archive.writestr(name, path.read_bytes()[: 200 if name == first else None])
    with pytest.raises(ImageError, match=f"capture.zip/{first}: "):
        photograph_case(tmp_path / "capture.zip", 2, 64, 64)


def test_views_left_over_are_neither_inputs_nor_targets_nor_without_photograph(tmp_path: Path) -> None:
    write_colmap(tmp_path, arc(9))
    missing = 8
    (tmp_path / "images" / names(9)[missing]).unlink()
    found = scene_views(tmp_path, 2)
    used = {*found.inputs.indices, *found.targets.indices}
    assert set(found.spare()) == set(range(8)) - used
    assert missing not in used


def test_the_report_tells_what_was_held_out(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Three of four views are no scene of three inputs: it is left out with the reason."""
    write_transforms(tmp_path / "four", arc(4))
    write_transforms(tmp_path / "seven", arc(7))
    out = tmp_path / "out"
    config = {"config": json.dumps({"sh_degree": 1, "experts": 6})}
    file = write_standin(tmp_path / "wide.onnx", {**METADATA, **config})
    asked = ("--inputs", 3, "--model", file, "--fade", 0, "--out", out)
    assert run(tmp_path / "four", tmp_path / "seven", *asked) == 0
    (group,) = json.loads((out / "report.json").read_text())["groups"]
    (scene,) = group["scenes"]
    said = scene["photographs"]
    assert (scene["scene"], said["by"], len(said["inputs"])) == ("seven", "held out", 3)
    text = (out / "report.md").read_text()
    assert f"- seven: inputs {', '.join(said['inputs'])}; targets {', '.join(said['targets'])}" in text
    assert "Left out: four: " in text
    assert "4 views with a photograph; with every second one held out" in group["left_out"]["four"]
    capfd.readouterr()
    assert run(tmp_path / "four", *asked) == 1
    refused(capfd, "4 views with a photograph; with every second one held out")
    assert run(tmp_path / "four", *asked, "--json") == 1
    told = json.loads(capfd.readouterr().out)["error"]
    assert told["cure"].startswith("take more photographs")
    assert told["detail"].count("SCENE_DIR") == 0
    with pytest.raises(NoSuchViews, match="take more photographs"):
        scene_views(tmp_path / "four", 3)


def test_one_capture_that_is_named_in_two_ways_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """It would count twice in the means."""
    write_transforms(tmp_path / "seven", arc(7))
    (camera_file,) = (tmp_path / "seven").glob("*.json")
    model = write_standin(tmp_path / "wide.onnx", {**METADATA, "config": json.dumps({"sh_degree": 1, "experts": 6})})
    asked = ("--inputs", 3, "--model", model, "--out", tmp_path / "out")
    assert run(tmp_path / "seven", camera_file, *asked) == 1
    told = f"SCENE_DIR: {camera_file.name} and seven are one capture, and would count so in the means: cameras of "
    refused(capfd, f"{told}{camera_file} (name it once")


def test_names_that_are_no_text_do_not_stop_a_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    report = Report([], [], None)
    monkeypatch.setattr(Report, "markdown", lambda _: "- inputs \udcf6IMG.png\n")
    report.write(tmp_path)
    assert (tmp_path / "report.md").read_text() == "- inputs \\udcf6IMG.png\n"
