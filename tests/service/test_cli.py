"""The command `gapmes`: its other commands, its exit codes, and one line instead of a traceback."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
import pytest
import typer
from cli_runs import assert_refusal, reconstruct, run
from PIL import Image
from ply_cases import binary_file, columns, gaussians
from typer.testing import CliRunner

from gapmes.service import Gaussians, cli, write_ply
from gapmes.service.formats.ply import ply_bytes
from gapmes.service.settings import Settings


@pytest.mark.parametrize("words", ["", "Unable to allocate 3 MiB"])
def test_memory_that_does_not_suffice_is_told_without_a_traceback(
    words: str, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def without_memory(*_: object, **__: object) -> None:
        raise MemoryError(*([words] if words else []))

    monkeypatch.setattr(cli, "app", without_memory)
    assert run("render", "--json") == 1
    refusal = assert_refusal(capfd, f"the memory does not suffice{': ' if words else ''}{words}")
    assert "ulimit" in refusal["cure"]


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
    dropped, zero, precision, empty = json.loads(capfd.readouterr().out)["warnings"]
    assert dropped == "1 of 20 Gaussians dropped, invalid in scale_1 (1)"
    assert zero == "1 of 19 rotations are zero and were taken as no rotation"
    assert precision.startswith("positions are float32 numbers far from the origin")
    assert empty.startswith("view 0: none of 19 Gaussians is drawn")


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


def test_every_default_that_a_help_text_names_is_shown() -> None:
    """Markup would take what stands in brackets for a style and leave it out."""
    runner, group = CliRunner(), typer.main.get_command(cli.app)
    context = click.Context(group)
    for name in group.list_commands(context):
        shown = runner.invoke(cli.app, [name, "--help"], env={"COLUMNS": "250"}).output
        flat = re.sub(r"[\s│]+", "", shown)
        for parameter in group.get_command(context, name).params:
            for bracket in re.findall(r"\[[^]]+\]", getattr(parameter, "help", None) or ""):
                assert re.sub(r"\s+", "", bracket) in flat, (name, parameter.name, bracket)


def test_no_default_is_shown_twice() -> None:
    """By the help text, and by what prints it."""
    runner, group = CliRunner(), typer.main.get_command(cli.app)
    context = click.Context(group)
    for name in group.list_commands(context):
        shown = runner.invoke(cli.app, [name, "--help"], env={"COLUMNS": "250"}).output
        for option in re.split(r"\s(?=--[a-z])", shown):
            assert option.count("[default:") <= 1, (name, option)


def test_the_help_of_serve_says_what_quiet_is_there() -> None:
    """Its log has warnings too, as the setting says; the other commands write errors alone."""
    shown = CliRunner().invoke(cli.app, ["serve", "--help"], env={"COLUMNS": "250"}).output
    meant = Settings.model_fields["quiet"].description.partition(" when ")[0]
    assert meant.startswith("log only warnings and errors")
    assert meant in shown


INTERRUPTED = """
import sys
class Interrupt:
    def find_spec(self, name, *_):
        if name == "gapmes.service.commands.convert":
            raise KeyboardInterrupt
sys.meta_path.insert(0, Interrupt())
from {} import {}
{}()
"""


def test_an_interrupt_while_the_commands_are_imported_is_no_traceback() -> None:
    scripts = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]["scripts"]
    module, _, function = scripts["gapmes"].partition(":")
    code = INTERRUPTED.format(module, function, function)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


def test_the_version(capfd: pytest.CaptureFixture[str]) -> None:
    assert run("--version") == 0
    assert re.fullmatch(r"gapmes \d+\.\d+\.\d+\n", capfd.readouterr().out)
