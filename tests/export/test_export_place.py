"""The place of an export: obstacles are refused before the work, and no partial file is left."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import onnx
import pytest
from little_models import small
from typer.testing import CliRunner

from gapmes.export import pipeline
from gapmes.export.cli import app
from gapmes.export.report import CaseResult, Report
from gapmes.service.errors import InputError

QUICK = {"height": 64, "width": 64, "quick": True}


def said_of(model: Path) -> dict[str, str]:
    return {entry.key: entry.value for entry in onnx.load(model).metadata_props}


def verdict(model: Path, *_: object) -> Report:
    return Report(pipeline.file_sha256(model), said_of(model)["gapmes.precision"], {}, [CaseResult("a", "b", 2)])


@pytest.fixture
def _stubbed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline, "export_graph", lambda *_: small())
    monkeypatch.setattr(pipeline, "quantised", lambda model: model)
    monkeypatch.setattr(pipeline, "_verify_elsewhere", verdict)


@pytest.mark.parametrize("link", [False, True])
def test_the_checkpoint_is_not_overwritten(checkpoint: Path, tmp_path: Path, link: bool) -> None:
    mine = tmp_path / "mine.safetensors"
    mine.write_bytes(checkpoint.read_bytes())
    out = mine
    if link:
        out = tmp_path / "link.onnx"
        out.symlink_to(mine)
    result = CliRunner().invoke(app, ["--checkpoint", str(mine), "-o", str(out)], env={"COLUMNS": "400"})
    assert result.exit_code == 1
    assert f"{out} would take the place of the checkpoint that it is made from" in result.output
    assert mine.read_bytes() == checkpoint.read_bytes()


@pytest.mark.parametrize("name", ["net.report.json", "net.rejected.onnx", "net.checkpoint.json"])
def test_a_folder_where_a_file_belongs_is_refused_before_any_work(name: str, checkpoint: Path, tmp_path: Path) -> None:
    (tmp_path / name).mkdir()
    with pytest.raises(InputError, match=f"{name} is a folder, need a file"):
        pipeline.export_checkpoint(checkpoint, tmp_path / "net.onnx", **QUICK)
    assert not (tmp_path / "net.onnx").exists()


@pytest.mark.usefixtures("_stubbed")
def test_behind_a_link_the_file_is_replaced_with_what_lies_beside_it(checkpoint: Path, tmp_path: Path) -> None:
    real, out = tmp_path / "real" / "net.onnx", tmp_path / "served.onnx"
    real.parent.mkdir()
    real.write_text("old")
    out.symlink_to(real)
    made = pipeline.export_checkpoint(checkpoint, out, **QUICK)
    assert out.readlink() == real
    assert said_of(out) == said_of(real)
    assert made.report_path == real.with_name("net.report.json")
    assert Report.read(made.report_path).model_sha256 == pipeline.file_sha256(out)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["real", "served.onnx"]


@pytest.mark.usefixtures("_stubbed")
def test_two_exports_to_one_place_do_not_meet(
    checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While one export is verified, another with another precision starts and ends: each is judged by its own file."""
    out = tmp_path / "net.onnx"
    inner = []

    def with_another(model: Path, *_: object) -> Report:
        monkeypatch.setattr(pipeline, "_verify_elsewhere", verdict)
        inner.append(pipeline.export_checkpoint(checkpoint, out, precision="int8", **QUICK))
        return verdict(model)

    monkeypatch.setattr(pipeline, "_verify_elsewhere", with_another)
    outer = pipeline.export_checkpoint(checkpoint, out, precision="fp32", **QUICK)
    assert [inner[0].report.precision, outer.report.precision] == ["int8", "fp32"]
    assert said_of(out)["gapmes.precision"] == Report.read(outer.report_path).precision == "fp32"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["net.onnx", "net.report.json"]


@pytest.mark.usefixtures("_stubbed")
def test_a_full_disk_is_said_of_the_file(checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pipeline, "write_model", full)
    out = tmp_path / "net.onnx"
    result = CliRunner().invoke(app, ["--checkpoint", str(checkpoint), "-o", str(out)], env={"COLUMNS": "400"})
    assert result.exit_code == 1
    assert f"No space left on device: '{out}'" in result.output
    assert list(tmp_path.iterdir()) == []


ENDED = """
import signal, sys, time
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # under nohup it would be ignored
from gapmes.export import cli, pipeline
from little_models import small
pipeline.export_graph = lambda *_: small()
def waits(model, *_):
    print(model, flush=True)
    time.sleep(600)
pipeline._verify_elsewhere = waits
sys.argv[1:] = ["--out", sys.argv[1], "--quiet"]
cli.main()
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_an_export_that_a_signal_ends_leaves_nothing(number: signal.Signals, tmp_path: Path) -> None:
    command = [sys.executable, "-c", ENDED, str(tmp_path / "net.onnx")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parent) as process:
        assert process.stdout is not None
        candidate = Path(process.stdout.readline().strip())
        try:
            assert candidate.is_file()
            process.send_signal(number)
            assert process.wait(120) == -number
        finally:
            process.kill()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--report", "out", "--top-k", "0"], "nothing is exported with --report and --stability"),
        (["--report", "out", "--quick", "--scene", "room"], "is not measured with --quick, which has the sample scene"),
    ],
)
def test_what_would_be_passed_over_is_wrong_usage(arguments: list[str], text: str) -> None:
    result = CliRunner().invoke(app, arguments, env={"COLUMNS": "400"})
    assert result.exit_code == 2
    assert text in result.output


@pytest.mark.usefixtures("_stubbed")
@pytest.mark.parametrize("before", [False, True])
def test_without_room_for_its_report_no_model_comes_into_place(
    checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, before: bool
) -> None:
    out = tmp_path / "net.onnx"
    if before:
        pipeline.export_checkpoint(checkpoint, out, **QUICK)
        for name in ("net.checkpoint.json", "net.rejected.onnx", "net.rejected.report.json"):
            (tmp_path / name).write_text("{}")
    there = {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Report, "write", full)
    with pytest.raises(OSError, match=r"net\.report\.json"):
        pipeline.export_checkpoint(checkpoint, out, precision="int8", **QUICK)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == there


@pytest.mark.usefixtures("_stubbed")
def test_what_tells_of_another_checkpoint_stays(checkpoint: Path, tmp_path: Path) -> None:
    """Such as the record of a training in the same folder; that of an export before goes with it."""
    record, out = tmp_path / "depth.checkpoint.json", tmp_path / "depth.onnx"
    record.write_text("{}")
    with pytest.raises(InputError, match=r"depth\.checkpoint\.json is there, which tells of a checkpoint"):
        pipeline.export_checkpoint(checkpoint, out, **QUICK)
    assert [path.name for path in tmp_path.iterdir()] == [record.name]
    record.unlink()
    pipeline.export_checkpoint(checkpoint, out, **QUICK)
    record.write_text("{}")
    pipeline.export_checkpoint(checkpoint, out, **QUICK)
    assert not record.exists()
    link = tmp_path / "link.onnx"
    link.symlink_to(out)
    beside = link.with_name("link.checkpoint.json")
    beside.write_text("{}")
    pipeline.export_checkpoint(checkpoint, link, **QUICK)  # nothing is written beside the link
    assert beside.read_text() == "{}"


@pytest.mark.usefixtures("_stubbed")
def test_the_name_of_rejected_files_is_not_for_others(checkpoint: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"net\.rejected\.onnx has the name of a rejected file"):
        pipeline.export_checkpoint(checkpoint, tmp_path / "net.rejected.onnx", **QUICK)
    assert list(tmp_path.iterdir()) == []
