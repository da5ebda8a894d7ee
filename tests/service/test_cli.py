"""The command `gapmes`: what it writes, its exit codes, and one line instead of a traceback."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from capture_scenes import arc, write_colmap, write_transforms, zipped
from PIL import Image
from ply_cases import binary_file, columns, gaussians

from gapmes.service import Gaussians, cli, read_ply, write_ply
from gapmes.service.ply import ply_bytes


@pytest.fixture
def scene_dir(tmp_path: Path) -> Path:
    """Four photographs of noise, side by side, with a cameras.json."""
    (tmp_path / "scene" / "images").mkdir(parents=True)
    views = []
    for index in range(4):
        name = f"images/{index:03d}.png"
        pixels = np.random.default_rng(index).integers(0, 256, (48, 64, 3), dtype=np.uint8)
        Image.fromarray(pixels).save(tmp_path / "scene" / name)
        pose = np.eye(4)
        pose[0, 3] = 0.2 * index
        views.append(
            {
                "image": name,
                "width": 64,
                "height": 48,
                "fx": 60.0,
                "fy": 60.0,
                "cx": 32.0,
                "cy": 24.0,
                "c2w": pose.tolist(),
            }
        )
    (tmp_path / "scene" / "cameras.json").write_text(json.dumps({"near": 1.0, "far": 10.0, "views": views}))
    return tmp_path / "scene"


def run(*arguments: object) -> int:
    """The exit code of `gapmes` with these arguments."""
    try:
        cli.main([str(argument) for argument in arguments])
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def reconstruct(scene_dir: Path, model: Path, *more: object) -> int:
    return run("reconstruct", scene_dir, "--model", model, "--threads", 1, "-o", scene_dir / "out.ply", *more)


def test_reconstruct_and_render(scene_dir: Path, standin_model: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert reconstruct(scene_dir, standin_model, "--views", "0,2", "--json") == 0
    out, err = capfd.readouterr()
    document = json.loads(out)
    assert document["selected_views"] == [0, 2]
    assert document["gaussians"]["count"] == len(read_ply(scene_dir / "out.ply"))
    for stage in (
        "load model",
        "kernels",
        "read images",
        "cameras",
        "images",
        "network",
        "gaussians",
        "leave out",
        "check",
        "write .ply",
    ):
        assert re.search(rf"^{re.escape(stage)} +\d+\.\d\d s$", err, re.MULTILINE), err

    cameras = scene_dir / "cameras.json"
    out_dir = scene_dir / "views"
    arguments = ("render", scene_dir / "out.ply", "--cameras", cameras, "-o", out_dir, "--threads", 1)
    assert run(*arguments, "--views", "1,2.5", "--json") == 0
    written = json.loads(capfd.readouterr().out)["views"]
    assert [(entry["view"], entry["width"], entry["height"]) for entry in written] == [("1", 64, 48), ("2.5", 64, 48)]
    assert sorted(path.name for path in out_dir.iterdir()) == ["view_1.png", "view_2.5.png"]

    assert run(*arguments, "--crop", "square", "--size", "32x32", "--views", "3") == 0
    assert Image.open(out_dir / "view_3.png").size == (32, 32)
    assert capfd.readouterr().out == ""


def test_reconstruction_is_the_same_twice(scene_dir: Path, standin_model: Path) -> None:
    assert reconstruct(scene_dir, standin_model, "--views", "0,1") == 0
    first = (scene_dir / "out.ply").read_bytes()
    assert reconstruct(scene_dir, standin_model, "--views", "0,1") == 0
    assert (scene_dir / "out.ply").read_bytes() == first


def test_transforms_json_without_sizes(scene_dir: Path, standin_model: Path) -> None:
    assert reconstruct(scene_dir, standin_model, "--views", "0,1") == 0
    expected = (scene_dir / "out.ply").read_bytes()
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    cameras = json.loads((scene_dir / "cameras.json").read_text())
    frames = [
        {"file_path": view["image"], "transform_matrix": (np.array(view["c2w"]) @ flip).tolist()}
        for view in cameras["views"]
    ]
    (scene_dir / "cameras.json").unlink()
    (scene_dir / "transforms.json").write_text(json.dumps({"fl_x": 60.0, "frames": frames}))
    assert reconstruct(scene_dir, standin_model, "--views", "0,1", "--near", 1, "--far", 10) == 0
    assert (scene_dir / "out.ply").read_bytes() == expected


def test_a_zip_and_a_folder_are_the_same_scene(
    scene_dir: Path, tmp_path: Path, standin_model: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """By names or by indices; the answer says what was used, of what."""
    assert reconstruct(scene_dir, standin_model, "--views", "0,2") == 0
    expected = (scene_dir / "out.ply").read_bytes()
    (scene_dir / "out.ply").unlink()
    packed = tmp_path / "capture.zip"
    packed.write_bytes(zipped(scene_dir, inside="scene/"))
    arguments = ("--model", standin_model, "--threads", 1, "-o", tmp_path / "out.ply", "--json")
    capfd.readouterr()
    for views in ("0,2", "000.png,images/002.png"):
        assert run("reconstruct", packed, *arguments, "--views", views) == 0
        assert (tmp_path / "out.ply").read_bytes() == expected
        out, err = capfd.readouterr()
        assert json.loads(out)["selection"] == {
            "by": "select",
            "format": "cameras.json",
            "cameras": "scene/cameras.json",
            "of": 4,
            "views": [0, 2],
            "images": ["scene/images/000.png", "scene/images/002.png"],
        }
        assert "views 0, 2 of 4 in scene/cameras.json (cameras.json): as asked for" in err


def test_of_many_views_some_are_chosen(tmp_path: Path, standin_model: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """COLMAP's model of nine photographs, of which three are used, or as many as are asked for."""
    (tmp_path / "scene").mkdir()
    write_colmap(tmp_path / "scene", arc(9))
    more = ("--near", 2, "--far", 8, "--trust-poses", "--leave-one-out", 0, "--json")
    for asked, count in (((), 3), (("--context", 2), 2), (("--context", 4), 4)):
        assert reconstruct(tmp_path / "scene", standin_model, *asked, *more) == 0
        out, err = capfd.readouterr()
        document = json.loads(out)
        assert len(document["selected_views"]) == len(document["cameras"]) == count
        said = document["selection"]
        assert (said["by"], said["of"], said["compared"], said["format"]) == ("score", 9, 9, "colmap")
        assert said["views"] == document["selected_views"]
        assert f"of 9 in sparse/0/images.bin (colmap): chosen for overlap ({said['overlap']:.0%})" in err


def test_photographs_through_a_lens_are_resampled(
    tmp_path: Path, standin_model: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "scene").mkdir()
    write_transforms(tmp_path / "scene", arc(2))
    path = tmp_path / "scene" / "transforms.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"k1": -0.1}))
    more = ("--near", 2, "--far", 8, "--trust-poses", "--json")
    assert reconstruct(tmp_path / "scene", standin_model, *more) == 0
    out, err = capfd.readouterr()
    document = json.loads(out)
    width, height = (document["cameras"][0][name] for name in ("width", "height"))
    told = [warning for warning in document["warnings"] if warning["code"] == "undistorted"]
    assert [warning["index"] for warning in told] == [0, 1]
    assert f"resampled to a pinhole of {width} x {height} px, which holds 9" in told[0]["message"]
    assert (width, height) != (96, 72)
    assert told[1]["message"] in err


def test_views_that_are_not_wanted_need_no_photograph(scene_dir: Path, standin_model: Path) -> None:
    (scene_dir / "images" / "001.png").unlink()
    assert reconstruct(scene_dir, standin_model, "--views", "0,2") == 0
    assert reconstruct(scene_dir, standin_model, "--views", "0,1") == 1


@pytest.mark.parametrize("unit", [1e-3, 1e3])
def test_pictures_do_not_depend_on_the_unit(scene_dir: Path, tmp_path: Path, unit: float) -> None:
    """Without near and far in the camera file, and with one camera or several: orbits and near plane follow."""
    rng = np.random.default_rng(0)
    count = 200
    gaussians = Gaussians(
        means=rng.uniform([-0.5, -0.5, 1.5], [1.0, 0.5, 3.0], (count, 3)),
        scales=np.full((count, 3), 0.05),
        rotations_wxyz=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
        opacities=np.full(count, 0.9),
        harmonics=rng.normal(size=(count, 1, 3)),
    )
    document = json.loads((scene_dir / "cameras.json").read_text())
    del document["near"], document["far"]
    pictures = []
    for name, scale in (("plain", 1.0), ("scaled", unit)):
        ply = tmp_path / f"{name}.ply"
        write_ply(ply, replace(gaussians, means=gaussians.means * scale, scales=gaussians.scales * scale))
        views = [view | {"c2w": (np.array(view["c2w"])[:3] * [1, 1, 1, scale]).tolist()} for view in document["views"]]
        drawn = []
        for kept in (views, views[:1]):
            cameras = tmp_path / "cameras.json"
            cameras.write_text(json.dumps({"views": kept}))
            out = tmp_path / f"{name}{len(kept)}"
            assert run("render", ply, "--cameras", cameras, "-o", out, "--views", "0,orbit:20", "--threads", 1) == 0
            drawn += [np.asarray(Image.open(path), float) for path in sorted(out.iterdir())]
        pictures.append(drawn)
    for plain, scaled in zip(*pictures, strict=True):
        assert plain.mean() > 10
        np.testing.assert_allclose(plain, scaled, atol=1)  # of 255; positions and scales are float32 in the file


def test_render_takes_sizes_from_the_photographs(scene_dir: Path, standin_model: Path, tmp_path: Path) -> None:
    assert reconstruct(scene_dir, standin_model, "--views", "0,1") == 0
    frames = [{"file_path": f"images/{i:03d}.png", "transform_matrix": np.eye(4).tolist()} for i in range(2)]
    cameras = scene_dir / "transforms.json"
    cameras.write_text(json.dumps({"fl_x": 60.0, "frames": frames}))
    assert run("render", scene_dir / "out.ply", "--cameras", cameras, "-o", tmp_path / "v", "--threads", 1) == 0
    assert Image.open(tmp_path / "v" / "view_1.png").size == (64, 48)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--views", "0,9"), "view 9 does not exist"),
        (("--views", "0"), "need 2 to 6"),
        (("--views", "0,0"), "given twice"),
        (("--views", "a,b"), "is not a view index, nor the name of a view"),
        (("--views", "0,1", "--context", "3"), "context: is given beside views"),
        (("--context", "7"), "context: 7 views, need 2 to 6"),
        (("--near", "5", "--far", "2"), "near"),
        (("--model", "missing.onnx"), "missing.onnx"),
    ],
)
def test_refusals_of_reconstruct(
    scene_dir: Path, standin_model: Path, capfd: pytest.CaptureFixture[str], arguments: tuple[str, ...], words: str
) -> None:
    if not {"--views", "--context"} & set(arguments):
        arguments = (*arguments, "--views", "0,1")
    assert reconstruct(scene_dir, standin_model, *arguments, "--json") == 1
    assert_refusal(capfd, words)
    assert not (scene_dir / "out.ply").exists()


def assert_refusal(capfd: pytest.CaptureFixture[str], words: str) -> dict[str, Any]:
    """One line on stderr, no traceback, and the problem as JSON on stdout."""
    out, err = capfd.readouterr()
    lines = [line for line in err.splitlines() if line.startswith("error: ")]
    assert len(lines) == 1, err
    assert words in lines[0]
    assert "Traceback" not in err
    error = json.loads(out)["error"]
    assert error["code"]
    assert error["detail"]
    return error


def test_other_refusals(scene_dir: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    cameras = scene_dir / "cameras.json"
    missing = tmp_path / "missing"
    assert run("reconstruct", missing, "-o", tmp_path / "x.ply", "--json") == 1
    assert_refusal(capfd, "missing")
    assert run("render", missing, "--cameras", cameras, "-o", tmp_path / "v", "--json") == 1
    assert_refusal(capfd, "missing")
    assert run("render", cameras, "--cameras", cameras, "-o", tmp_path / "v", "--json") == 1
    assert assert_refusal(capfd, "error: format: 'cameras.json' ends in none of ply,")["code"] == "invalid_input"
    broken = tmp_path / "broken.ply"
    broken.write_bytes(b"ply\nformat binary_little_endian 1.0\nelement vertex many\nend_header\n")
    assert run("render", broken, "--cameras", cameras, "-o", tmp_path / "v", "--json") == 1
    assert assert_refusal(capfd, "error: header: line")["code"] == "ply_invalid"
    assert run("render", cameras, "--cameras", missing, "-o", tmp_path / "v", "--json") == 1
    assert_refusal(capfd, "missing")
    assert run("render", cameras, "--cameras", cameras, "-o", tmp_path / "v", "--size", "huge", "--json") == 1
    assert_refusal(capfd, "is not a size")
    assert run("render", cameras, "--cameras", cameras, "-o", tmp_path / "v", "--views", "7", "--json") == 1
    assert assert_refusal(capfd, "7 is out of range, there are 4 views")["field"] == "views"
    document = json.loads(cameras.read_text())
    cameras.write_text(json.dumps(document | {"near": -1.0}))
    assert run("render", cameras, "--cameras", cameras, "-o", tmp_path / "v", "--views", "orbit:9", "--json") == 1
    assert_refusal(capfd, "near = -1")
    views = [view | {"fx": 0.5 if index == 2 else 60.0} for index, view in enumerate(document["views"])]
    cameras.write_text(json.dumps(document | {"views": views}))
    assert run("render", cameras, "--cameras", cameras, "-o", tmp_path / "v", "--json") == 1
    assert_refusal(capfd, "error: view 2: views.fx: fx = 0.5 px for an image of 64 px")
    cameras.write_text(json.dumps(document))
    (scene_dir / "images" / "000.png").write_text("no image")
    assert run("reconstruct", scene_dir, "-o", tmp_path / "x.ply", "--model", missing, "--json") == 1
    assert_refusal(capfd, "missing")


def test_image_that_is_none(scene_dir: Path, standin_model: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (scene_dir / "images" / "002.png").write_text("no image")
    assert reconstruct(scene_dir, standin_model, "--views", "0,2", "--json") == 1
    assert assert_refusal(capfd, "view 2")["code"] == "image_unreadable"


@pytest.mark.parametrize(
    "arguments",
    [
        ("nothing",),
        ("reconstruct",),
        ("render", "a.ply"),
        ("serve", "--port", "x"),
        ("serve", "--port", "70000"),
        ("demo", "--what"),
    ],
)
def test_wrong_usage(arguments: tuple[str, ...], capfd: pytest.CaptureFixture[str]) -> None:
    assert run(*arguments) == 2
    assert "Traceback" not in capfd.readouterr().err


def test_serve_refuses_before_it_listens(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    assert run("serve", "--model", "missing.onnx") == 1
    assert "missing.onnx" in capfd.readouterr().err
    monkeypatch.setenv("GAPMES_MAX_WAITING", "many")
    assert run("serve") == 1
    assert "GAPMES_MAX_WAITING" in capfd.readouterr().err


@pytest.mark.parametrize("command", ["serve", "reconstruct", "render", "convert", "demo"])
def test_help(command: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert run(command, "--help") == 0
    assert "Usage" in capfd.readouterr().out


@pytest.mark.case("A1", "E12", "E19")
def test_render_tells_what_it_did_not_take_as_it_was(
    scene_dir: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """A Gaussian that is no number is refused or dropped, a zero rotation counted, float32 far off told."""
    table = columns(ply_bytes(gaussians(20, degree=0)))
    table = {name: column.copy() for name, column in table.items()} | {"x": (table["x"] + 1e7).astype(np.float32)}
    table["scale_1"][3] = np.nan
    for part in range(4):
        table[f"rot_{part}"][5] = 0
    ply = tmp_path / "foreign.ply"
    ply.write_bytes(binary_file(table))
    arguments = ("render", ply, "--cameras", scene_dir / "cameras.json", "-o", tmp_path / "v", "--views", "0", "--json")
    assert run(*arguments) == 1
    assert json.loads(capfd.readouterr().out)["error"]["field"] == "vertex.scale_1"
    assert run(*arguments, "--drop-invalid") == 0
    dropped, zero, precision = json.loads(capfd.readouterr().out)["warnings"]
    assert dropped == "1 of 20 Gaussians dropped, invalid in scale_1 (1)"
    assert zero == "1 of 19 rotations are zero and were taken as no rotation"
    assert precision.startswith("positions are float32 numbers far from the origin")


@pytest.mark.parametrize(
    ("shell", "words"),
    [
        ("bash", "complete -o default -F _gapmes_completion gapmes"),
        ("zsh", "compdef _gapmes_completion gapmes"),
        ("fish", "complete --command gapmes"),
        ("pwsh", "-Native -CommandName gapmes"),
    ],
)
def test_a_shell_gets_a_script_that_completes_this_command(shell: str, words: str) -> None:
    """`--show-completion` asks which process it was called from; this variable of typer's lets it be told."""
    told = {"_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    command = [sys.executable, "-c", "import sys; sys.argv[0] = 'gapmes'; from gapmes.service.cli import main; main()"]
    command += ["--show-completion", shell]
    done = subprocess.run(command, env=os.environ | told, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done
    assert words in done.stdout
    assert "_GAPMES_COMPLETE" in done.stdout


def test_shells_complete_commands_and_options() -> None:
    """As a shell asks: with the words so far in the environment."""
    for words, expected in (("gapmes re", {"reconstruct", "render"}), ("gapmes doctor --mo", {"--model"})):
        asked = {"_GAPMES_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
        command = [sys.executable, "-c", "from gapmes.service.cli import app; app(prog_name='gapmes')"]
        done = subprocess.run(command, env=os.environ | asked, capture_output=True, text=True, check=False)
        assert expected <= set(done.stdout.split()), done
