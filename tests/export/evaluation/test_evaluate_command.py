"""`gapmes evaluate` end to end, on generated scenes and on the sample: its output and its refusals."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from evaluate_runs import refused, run
from PIL import Image
from standin_model import METADATA, write_standin

from gapmes.export.evaluation import command, models
from gapmes.export.evaluation import run as measuring
from gapmes.export.evaluation.case import GENERATED_SEED
from gapmes.export.evaluation.scores import BASELINES, TRUE_DEPTH, Group
from gapmes.export.memory import OutOfMemory
from gapmes.export.pipeline import VerificationBroken
from gapmes.export.size import Size
from gapmes.service import cli, extra_commands
from gapmes.service.network.contract import REQUIRED_OUTPUTS
from gapmes.service.shipped import sample_folder, shipped_model


def test_two_models_on_generated_scenes(
    small_graph: onnx.ModelProto,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A 64 px network against a copy of it under another name: same cases, no difference; the worse one is drawn."""
    monkeypatch.setattr("gapmes.export.evaluation.run.GENERATED_SHEETS", 1)
    for name in ("one", "other"):
        (tmp_path / f"{name}.onnx").write_bytes(small_graph.SerializeToString())
    files = ("--model", tmp_path / "one.onnx", "--model", tmp_path / "other.onnx")
    out = tmp_path / "report"
    assert run("--generated", 2, *files, "--out", out, "--json", "--twice") == 0
    printed, _ = capfd.readouterr()
    document = json.loads((out / "report.json").read_text())
    assert json.loads(printed) == document
    (group,) = document["groups"]
    assert (group["kind"], group["inputs"], group["height"], group["width"], group["covisible_from"]) == (
        "generated",
        2,
        64,
        64,
        "true depth",
    )
    assert set(group["mean"]) == {*BASELINES, TRUE_DEPTH, "one", "other"}
    assert group["mean"]["one"] == group["mean"]["other"]
    for entry in group["scenes"]:
        model = entry["models"]["one"]
        assert entry["margin"]["one"] == pytest.approx(
            model["score"]["all"]["psnr"] - max(entry["baselines"][name]["all"]["psnr"] for name in BASELINES)
        )
        assert 0 < entry["covisible_share"] <= 1
        assert model["twice"]["change"] == pytest.approx(model["twice"]["psnr"] - model["score"]["all"]["psnr"])
        assert model["twice"]["side_px"] == 128
    routing = group["routing"]["one"]
    assert sum(routing["expert_share"]) == pytest.approx(1)
    assert routing["patches"] == 2 * 2 * 16
    assert set(routing["lambdas"]) == {"experts", "tasks"}
    text = (out / "report.md").read_text()
    assert "Difference between the models" in text
    assert text.count("| mean | one |") == 1
    worst = min(group["scenes"], key=lambda entry: entry["margin"]["one"])
    (picture,) = out.glob("*.png")
    assert picture.name == f"{worst['scene'].replace(' ', '_')}_2views_64px.png"
    with Image.open(picture) as sheet:
        assert sheet.size[0] > 4 * 64


def test_the_shipped_model_on_photographs(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """The sample scene by the defaults of a folder; co-visibility comes from what the model drew."""
    arguments = (sample_folder(), "--inputs", 2, "--size", 256, "--twice", "--out", tmp_path)
    assert run(*arguments) == 0
    document = json.loads((tmp_path / "report.json").read_text())
    (group,) = document["groups"]
    (entry,) = group["scenes"]
    assert group["covisible_from"] == "rendered depth of ours"
    ours = entry["models"]["ours"]
    assert ours["score"]["all"]["psnr"] > entry["baselines"]["nearest input"]["all"]["psnr"] + 3
    assert ours["twice"]["side_px"] == 256
    assert ours["twice"]["change"] == pytest.approx(ours["twice"]["psnr"] - ours["score"]["all"]["psnr"])
    assert "photograph has 256 px on its shorter side, enlarged" in (tmp_path / "report.md").read_text()
    assert (tmp_path / "sample_2views_256px.png").is_file()
    missed = any(floor["passed"] is False for floor in document["floors"])
    assert ("MISSED" in capfd.readouterr().err) == missed


@pytest.mark.parametrize("passed", [True, False, None])
def test_check_sets_the_exit_code(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, passed: bool | None) -> None:
    from gapmes.export.evaluation import report
    from gapmes.export.evaluation import run as whole
    from gapmes.export.evaluation.floors import Floor

    monkeypatch.setattr(report, "floors", lambda groups: [Floor("a", "> 1", "1", passed)])
    monkeypatch.setattr(whole, "load_models", lambda *_, **__: [])
    none = Group("generated", 2, Size(64, 64), "true depth", [], {})
    monkeypatch.setattr(whole, "_group", lambda *_: none)
    monkeypatch.setattr(whole.Report, "write", lambda *_: None)
    assert run("--generated", 1, "--size", 64, "--out", tmp_path, "--check") == (1 if passed is False else 0)
    assert run("--generated", 1, "--size", 64, "--out", tmp_path) == 0


def test_refusals_are_one_line(
    tmp_path: Path, checkpoint: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    monkeypatch.setattr(measuring, "load_models", None)  # which may export, for minutes
    assert run(tmp_path / "missing", "--out", out) == 1
    refused(capfd, "missing")
    (tmp_path / "file").write_text("")
    assert run("--generated", 1, "--size", 64, "--out", tmp_path / "file") == 1
    refused(capfd, f"error: out: {tmp_path / 'file'} is not a folder")
    (tmp_path / "scene").mkdir()
    for text, words in (
        ("{bad", "is no JSON"),
        ("[]", f"{tmp_path / 'scene'}: is a list, need a JSON object"),
        ('{"views": []}', f"{tmp_path / 'scene'}: views must be a non-empty list"),
        ('{"suggested": null}', "lists of view indices"),
        ('{"suggested": {"context2": [0, "1"], "target2": [2]}}', "lists of view indices"),
        ('{"suggested": {}}', "suggests no context"),
    ):
        (tmp_path / "scene" / "cameras.json").write_text(text)
        assert run(tmp_path / "scene", "--out", out) == 1
        refused(capfd, words)
    for name in ("one", "other"):
        shutil.copytree(sample_folder(), tmp_path / "two" / name)
    spoilt = tmp_path / "two" / "other" / "images" / "002.png"
    spoilt.write_text("junk")
    scenes = (tmp_path / "two" / "one", tmp_path / "two" / "other")
    assert run(*scenes, "--inputs", 2, "--out", out) == 1
    refused(capfd, f"{spoilt}: 4 bytes are not a JPEG")
    assert run(scenes[0], "--inputs", 2, "--lpips", tmp_path / "none.safetensors", "--out", out) == 1
    refused(capfd, "none.safetensors")
    assert not out.exists()
    monkeypatch.undo()
    assert run("--generated", 1, "--size", 96, "--model", shipped_model(), "--out", out) == 1
    refused(capfd, "(tiny.onnx: 256) than 96 px")
    assert run("--generated", 1, "--size", "64x", "--out", out) == 1
    refused(capfd, "HEIGHTxWIDTH")
    assert run("--generated", 1, "--size", "64x31", "--out", out) == 1
    refused(capfd, "is 64x31 px, need 32 or more")
    monkeypatch.setattr(measuring, "load_models", None)
    for arguments in (("--size", 250), ("--size", 256, "--size", "64x250"), ("--size", 250, "--model", checkpoint)):
        assert run("--generated", 1, *arguments, "--out", tmp_path / "none") == 1
        refused(capfd, "is 250 px, need a multiple of 16 of at least 32")
    assert not (tmp_path / "none").exists()
    monkeypatch.undo()
    assert run("--generated", 0, "--out", out) == 1
    refused(capfd, "--generated 100")
    (tmp_path / "bad.safetensors").write_bytes(b"not weights")
    assert run("--generated", 1, "--size", 64, "--lpips", tmp_path / "bad.safetensors", "--out", out) == 1
    refused(capfd, "safetensors")
    monkeypatch.setattr(command, "find_spec", lambda name: None if name == "torch" else name)
    assert run("--generated", 1, "--out", out) == 1
    refused(capfd, "pip install 'gapmes[export]'")


@pytest.mark.parametrize("error", [OutOfMemory("no room"), VerificationBroken("no room"), ValueError("no room")])
def test_an_export_that_fails_is_refused_in_one_line_after_what_was_to_be_done(
    error: Exception, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(models, "export_checkpoint", fails)
    assert run("--generated", 2, "--size", 64, "--out", tmp_path) == 1
    told, refusal = capfd.readouterr().err.splitlines()
    assert told.startswith("measures 2 scenes of 64 px from 2 views (generated); exports and verifies tiny.safetensors")
    assert refusal == "error: model: tiny.safetensors cannot be exported for 64 px: no room"


@pytest.mark.parametrize("allocate", [torch.empty, np.empty])
@pytest.mark.parametrize("where", ["_group", "Report"])
def test_a_lack_of_memory_is_one_line(
    where: str,
    allocate: Callable[[int], object],
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(measuring, "load_models", lambda *_, **__: [])
    monkeypatch.setattr(measuring, where, lambda *_, **__: allocate(2**58))
    assert run("--generated", 2, "--size", 64, "--out", tmp_path, "--json") == 1
    told = capfd.readouterr()
    refusal = [line for line in told.err.splitlines() if line.startswith("error: ")]
    assert len(refusal) == 1
    assert refusal[0].startswith("error: not enough memory to evaluate")
    assert refusal[0].endswith(": take a smaller --size, or a machine with more memory")
    assert "Traceback" not in told.err
    assert json.loads(told.out)["error"]["detail"] == refusal[0].removeprefix("error: ")


def test_the_command_line_starts_without_torch_and_knows_the_command() -> None:
    code = (
        "import sys\n"
        "from gapmes.service import cli\n"
        "try:\n    cli.main(['--help'])\nexcept SystemExit:\n    pass\n"
        "sys.exit('torch' in sys.modules)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert "evaluate" in result.stdout
    assert "reconstruct" in result.stdout


def test_entry_points_are_read_only_for_other_names(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    asked: list[dict[str, str]] = []

    def none_found(**query: str) -> list[object]:
        asked.append(query)
        return []

    monkeypatch.setattr(extra_commands, "entry_points", none_found)
    for name, code, queries in (("render", 0, 0), ("no-such-command", 2, 1)):
        with pytest.raises(SystemExit) as end:
            cli.main([name, "--help"])
        assert (end.value.code, len(asked)) == (code, queries)
    assert "No such command" in capfd.readouterr().err


def test_generated_scenes_of_another_seed(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """The scenes differ from the usual ones, and the report names their seed."""
    file = write_standin(tmp_path / "wide.onnx", {**METADATA, "config": json.dumps({"sh_degree": 1, "experts": 6})})
    groups = []
    for number, seed in enumerate(((), ("--seed", 7))):
        out = tmp_path / str(number)
        assert run("--generated", 1, "--model", file, "--fade", 0, *seed, "--out", out) == 0
        (group,) = json.loads((out / "report.json").read_text())["groups"]
        groups.append(group)
        assert f"## generated (seed {group['seed']}), 2 views, 48x64 px" in (out / "report.md").read_text()
    assert [group["seed"] for group in groups] == [GENERATED_SEED, 7]
    usual, other = (group["mean"]["nearest input"]["all"]["psnr"] for group in groups)
    assert usual != other
    assert run(sample_folder(), "--seed", 7, "--size", 64, "--out", tmp_path / "none") == 1
    refused(capfd, "seed: is 7, but no scene is generated")
    assert run("--generated", 1, "--seed", -1, "--out", tmp_path / "none") == 2


def test_scenes_of_the_same_last_name_stay_apart(tmp_path: Path) -> None:
    """In tables, in pictures, and among the scenes that are left out."""
    for place in ("a", "b", "c"):
        shutil.copytree(sample_folder(), tmp_path / place / "room")
    lacking = tmp_path / "c" / "room" / "cameras.json"
    lacking.write_text(json.dumps({**json.loads(lacking.read_text()), "suggested": {}}))
    file = write_standin(tmp_path / "wide.onnx", {**METADATA, "config": json.dumps({"sh_degree": 1, "experts": 6})})
    out = tmp_path / "report"
    folders = [tmp_path / place / "room" for place in ("a", "b", "c")]
    assert run(*folders, "--inputs", 2, "--model", file, "--fade", 0, "--out", out) == 0
    (group,) = json.loads((out / "report.json").read_text())["groups"]
    assert [entry["scene"] for entry in group["scenes"]] == ["a/room", "b/room"]
    assert list(group["left_out"]) == ["c/room"]
    assert sorted(path.name for path in out.glob("*.png")) == [f"{p}_room_2views_48x64px.png" for p in ("a", "b")]


def test_pictures_of_photographs_stay_whatever_their_folders_are_called(tmp_path: Path) -> None:
    """A run removes only the pictures of generated scenes that an earlier run has drawn."""
    names = ["generated_house", "generated 000"]
    for name in names:
        shutil.copytree(sample_folder(), tmp_path / name)
    file = write_standin(tmp_path / "wide.onnx", {**METADATA, "config": json.dumps({"sh_degree": 1, "experts": 6})})
    out = tmp_path / "report"
    out.mkdir()
    ending = "_2views_48x64px.png"
    for name in ("generated_001", "generated_1000"):
        (out / f"{name}{ending}").touch()
    (out / "generated_001_3views_48x64px.png").touch()  # of another group
    folders = [tmp_path / name for name in names]
    assert run(*folders, "--generated", 1, "--inputs", 2, "--model", file, "--fade", 0, "--out", out) == 0
    pictures = {path.name: path.stat().st_size > 0 for path in out.glob("*.png")}
    assert pictures == {
        f"generated_house{ending}": True,
        f"generated_000_2{ending}": True,
        f"generated_000{ending}": True,
        "generated_001_3views_48x64px.png": False,
    }


def test_a_network_without_gates_is_measured(tmp_path: Path) -> None:
    """DepthSplat's configuration, for example, has no number of experts."""
    file = write_standin(tmp_path / "plain.onnx", outputs=REQUIRED_OUTPUTS)
    out = tmp_path / "report"
    assert run("--generated", 1, "--model", file, "--fade", 0, "--out", out) == 0
    (group,) = json.loads((out / "report.json").read_text())["groups"]
    assert group["routing"] == {"plain": None}
    assert "Routing of" not in (out / "report.md").read_text()
