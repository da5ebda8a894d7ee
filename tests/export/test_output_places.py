"""The output of an export: checked before the work, and left in a defined state however the export ends."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import onnx
import pytest
from standin_model import write_standin
from typer.testing import CliRunner

from gapmes.export import pipeline
from gapmes.export.cli import app
from gapmes.export.compare import Deviation
from gapmes.export.model_file import data_files
from gapmes.export.pipeline import ExportRejected, VerificationBroken, export_checkpoint
from gapmes.export.report import CaseResult, Report
from gapmes.model.weights_file import file_sha256
from gapmes.service.errors import InputError
from gapmes.service.network.engine import Engine

Verify = Callable[..., Report]


@pytest.fixture(autouse=True)
def _standin(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Instead of a network, whose export takes minutes; its weights lie in a file beside it."""
    model = onnx.load(write_standin(tmp_path_factory.mktemp("standin") / "model.onnx"))
    monkeypatch.setattr(pipeline, "export_graph", lambda *_: model)
    monkeypatch.setattr("gapmes.export.model_file.EXTERNAL_BYTES", 1000)


def judged(monkeypatch: pytest.MonkeyPatch, verdict: Report | BaseException) -> list[set[str]]:
    """The verification ends so; returns what it saw in the folder."""
    seen: list[set[str]] = []

    def verify(model: Path, _checkpoint: Path, report: Path, *_: object) -> Report:
        report.write_text("{}")
        seen.append(names(model.parent))
        Engine(model, threads=1)  # a whole model of that name
        if isinstance(verdict, Report):
            return replace(verdict, model_sha256=file_sha256(model))
        raise verdict

    monkeypatch.setattr(pipeline, "_verify_elsewhere", verify)
    return seen


def names(folder: Path) -> set[str]:
    """The names of the files in a folder, without the digits of weights."""
    return {path.name if path.suffix != ".data" else path.name[:-18] + ".data" for path in folder.iterdir()}


def report_of(*failures: str) -> Report:
    return Report("", "fp32", {}, [CaseResult("random", "as trained", 2, failures=list(failures))])


@pytest.mark.parametrize("value", [math.inf, math.nan])
def test_a_report_is_json_also_of_what_is_not_finite(value: float, tmp_path: Path) -> None:
    far = Deviation(value, value, value, 1.0, value, finite=False)
    report = Report("", "fp32", {}, [CaseResult("random", "as trained", 2, {"depth": far}, failures=["depth"])])
    path = tmp_path / "report.json"
    report.write(path)

    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is not JSON")

    (case,) = json.loads(path.read_text(), parse_constant=refuse)["cases"]
    assert case["outputs"]["depth"]["maximum"] is None
    assert Report.read(path).cases[0].outputs["depth"].maximum == math.inf


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="no file system that takes no new file")
def test_a_place_that_takes_no_file_is_refused_before_the_work(
    checkpoint: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also a folder that root may write to by its access bits."""
    monkeypatch.setattr(pipeline, "load_variant", None)
    for place in ("/proc/a.onnx", "/proc/new/a.onnx"):
        with pytest.raises(InputError, match="cannot be written"):
            export(checkpoint, Path(place))


def test_an_empty_name_is_a_folder(checkpoint: Path) -> None:
    with pytest.raises(InputError, match="is a folder, need a file"):
        export(checkpoint, Path(""))


def export(checkpoint: Path, out: Path) -> pipeline.Exported:
    return export_checkpoint(checkpoint, out, height=48, width=64)


@pytest.mark.parametrize(("precision", "cured"), [("fp32", False), ("int8", True)])
def test_a_rejection_counts_its_checks_and_names_the_cure_of_8_bits(precision: str, cured: bool) -> None:
    for failures, said in ((["a: off"], "1 check failed, first: "), (["a: off", "b: off"], "2 checks failed, first: ")):
        told = str(ExportRejected(Path(), Path(), replace(report_of(*failures), precision=precision)))
        assert told.startswith(f"{said}random (as trained, 2 views): a: off")
        assert told.endswith("too few for these weights: take --precision fp32") == cured


def test_a_file_has_its_name_only_once_it_is_judged(
    checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = judged(monkeypatch, report_of("depth: off"))
    out = tmp_path / "net.onnx"
    with pytest.raises(ExportRejected, match="depth: off") as caught:
        export(checkpoint, out)
    assert seen == [{"net.onnx", "net.onnx.data", "net.report.json"}]  # in a folder of their own
    kept = {"net.rejected.onnx", "net.rejected.onnx.data", "net.rejected.report.json"}
    assert names(tmp_path) == kept
    rejected = caught.value.rejected
    assert rejected == tmp_path / "net.rejected.onnx"
    assert Report.read(caught.value.report_path) == caught.value.report
    assert caught.value.report.model_sha256 == file_sha256(rejected)
    assert len(data_files(rejected)) == 1
    Engine(rejected, threads=1)

    judged(monkeypatch, report_of())
    result = export(checkpoint, out)  # and takes what was rejected before away
    assert names(tmp_path) == {"net.onnx", "net.onnx.data", "net.report.json"}
    assert Report.read(result.report_path).model_sha256 == file_sha256(out)


@pytest.mark.parametrize("end", [KeyboardInterrupt(), VerificationBroken("no verdict")])
def test_without_a_verdict_nothing_stays(
    end: BaseException, checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    judged(monkeypatch, report_of())
    export(checkpoint, tmp_path / "net.onnx")
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    seen = judged(monkeypatch, end)
    with pytest.raises(type(end)):
        export(checkpoint, tmp_path / "net.onnx")
    assert len(seen) == 1
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize(
    ("place", "said"),
    [
        ("folder", "folder is a folder, need a file"),
        (".", "is a folder, need a file"),
        ("taken/x.onnx", "taken is not a folder"),
        ("taken/deep/x.onnx", "taken is not a folder"),
        ("net", "net ends in '', need '.onnx', which tells networks from weights (name it net.onnx)"),
        ("other.safetensors", "name it other.safetensors.onnx"),
        ("net.v2", "name it net.v2.onnx"),  # its report would be that of net.onnx
    ],
)
def test_a_place_that_cannot_be_written_is_refused_before_any_work(
    place: str, said: str, checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "taken").touch()
    (tmp_path / "folder").mkdir()
    monkeypatch.setattr(pipeline, "load_variant", None)  # no work is done
    with pytest.raises(InputError, match=re.escape(said)):
        export(checkpoint, tmp_path / place)
    result = CliRunner().invoke(app, ["-o", str(tmp_path / place)], env={"COLUMNS": "200"})
    assert result.exit_code == 1
    assert result.output.startswith("refused: out: ")
    assert said in result.output
    assert names(tmp_path) == {"taken", "folder"}


def test_a_device_is_not_replaced(checkpoint: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline, "load_variant", None)
    with pytest.raises(InputError, match=r"/dev/null is a pipe or device"):
        export(checkpoint, Path("/dev/null"))


def test_an_interrupt_ends_the_verification_too(
    checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also if it was sent to the exporter alone: the other process would otherwise run on for minutes."""
    started = []
    real = pipeline.subprocess.Popen

    def slow(_: object, **options: object) -> object:
        script = "import time; print('{\"total\": 2}', flush=True); time.sleep(600)"
        started.append(real([pipeline.sys.executable, "-c", script], **options))
        return started[0]

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(pipeline.subprocess, "Popen", slow)
    with pytest.raises(KeyboardInterrupt):
        pipeline._verify_elsewhere(tmp_path / "a.onnx", checkpoint, tmp_path / "a.json", True, interrupted)
    assert started[0].returncode < 0


@pytest.mark.parametrize(
    ("script", "said"),
    [
        ("raise RuntimeError('no room')", "ended with 1: RuntimeError: no room"),
        ("raise SystemExit(5)", "ended with 5: it does not say why"),
        (
            "import os; os.kill(os.getpid(), 9)",
            "was ended by SIGKILL; lack of memory may be why: take a smaller --size",
        ),
        ("import os; os.kill(os.getpid(), 15)", "was ended by SIGTERM"),
        ("import os; os.kill(os.getpid(), 40)", "was ended by signal 40"),
    ],
)
def test_a_verification_that_breaks_is_told_in_one_line(
    script: str, said: str, checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = pipeline.subprocess.Popen

    def broken(_: object, **options: object) -> object:
        return real([pipeline.sys.executable, "-c", script], **options)

    monkeypatch.setattr(pipeline.subprocess, "Popen", broken)
    with pytest.raises(VerificationBroken) as ended:
        pipeline._verify_elsewhere(tmp_path / "a.onnx", checkpoint, tmp_path / "a.json", True, lambda *_: None)
    assert str(ended.value).startswith(f"the verification process {said}")
    assert "\n" not in str(ended.value)
