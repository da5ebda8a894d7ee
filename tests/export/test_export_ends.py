"""Ends of an export without a verdict: a signal during a write, too little memory, a strange working folder."""

from __future__ import annotations

import signal
import stat
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from little_models import small
from test_export_place import QUICK, verdict
from typer.testing import CliRunner

from gapmes.export import pipeline
from gapmes.export.build import export_graph
from gapmes.export.cli import app
from gapmes.export.model_file import write_model
from gapmes.model.architectures import Loaded
from gapmes.model.checkpoint import load_checkpoint
from gapmes.model.network import GaPMeS
from gapmes.model.pretrained.fit import Fit

WRITES = """
import signal, sys, tempfile, time
from pathlib import Path
signal.signal(signal.SIGHUP, signal.SIG_DFL)
from gapmes.export import model_file, quantise
from gapmes.service.process.ending import ended_in_order
from little_models import product, small
folder = Path(sys.argv[2])
tempfile.tempdir = str(folder)
model_file.EXTERNAL_BYTES = 2**26 if sys.argv[1] == "graph" else 1000
if sys.argv[1] == "graph of weights":
    model_file.write_model(product(2), folder / "net.onnx")
def waits(*_):
    print("now", flush=True)
    time.sleep(600)
write = Path.write_bytes
def half(path, data):
    write(path, data[:10])
    waits()
Path.write_bytes = half
if sys.argv[1] == "weights":
    model_file.add_metadata = waits  # once they are written
quantise._quantise = waits
with ended_in_order():
    if sys.argv[1] == "quantised":
        quantise.quantised(small())
    model_file.write_model(product(1), folder / "net.onnx")
"""


@pytest.mark.parametrize(
    ("what", "unfinished", "kept"),
    [("graph", 1, 0), ("weights", 1, 0), ("quantised", 1, 0), ("graph of weights", 2, 2)],
)
def test_a_signal_while_a_file_is_written_leaves_no_part_of_it(
    what: str, unfinished: int, kept: int, tmp_path: Path
) -> None:
    """The last writes in the place of a graph with weights of its own, which both stay."""
    command = [sys.executable, "-c", WRITES, what, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parent) as process:
        assert process.stdout is not None
        try:
            assert process.stdout.readline() == "now\n"
            assert len(list(tmp_path.iterdir())) == unfinished + kept
            process.send_signal(signal.SIGTERM)
            assert process.wait(120) == -signal.SIGTERM
        finally:
            process.kill()
    assert len(list(tmp_path.iterdir())) == kept
    if kept:
        onnx.load(tmp_path / "net.onnx")  # finds its weights


def test_a_model_that_is_replaced_keeps_its_mode(tmp_path: Path) -> None:
    path = tmp_path / "net.onnx"
    path.touch()
    path.chmod(0o640)
    write_model(small(), path)
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


def test_without_room_for_the_record_of_a_foreign_checkpoint_nothing_changes(
    checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def breaks(_: Fit, path: Path) -> None:
        path.write_text("{")
        raise OSError(28, "No space left on device", str(path))

    fit = Fit("a.pth", "0", "a network", "theirs", "", {}, {}, {})
    monkeypatch.setattr(pipeline, "load_variant", lambda *_: Loaded(load_checkpoint(checkpoint), fit))
    monkeypatch.setattr(pipeline, "export_graph", lambda *_: small())
    monkeypatch.setattr(pipeline, "_verify_elsewhere", verdict)
    monkeypatch.setattr(Fit, "write", breaks)
    before = {name: f"{name} before" for name in ("net.checkpoint.json", "net.onnx", "net.report.json")}
    for name, text in before.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(OSError, match=r"No space left on device: '.*net\.checkpoint\.json'"):
        pipeline.export_checkpoint(checkpoint, tmp_path / "net.onnx", **QUICK)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize("allocate", [torch.empty, np.empty])
def test_a_lack_of_memory_is_refused_with_the_size(
    allocate: Callable[[int], object], checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pipeline, "export_graph", lambda *_: allocate(2**58))
    arguments = ["--checkpoint", str(checkpoint), "--size", "64", "-o", str(tmp_path / "net.onnx")]
    result = CliRunner().invoke(app, arguments, env={"COLUMNS": "400"})
    assert result.exit_code == 1
    assert "refused: not enough memory to export for 64x64 px" in result.output
    assert "take a smaller --size" in result.output
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("stage", ["quantised", "add_metadata", "write_model", "_verify_elsewhere", "_kept"])
def test_a_lack_of_memory_in_a_later_stage_is_refused_too(
    stage: str, checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lacks(*_: object) -> None:
        raise MemoryError

    stub = {"export_graph": lambda *_: small(), "quantised": lambda model: model, "_verify_elsewhere": verdict}
    for name, function in (stub | {stage: lacks}).items():
        monkeypatch.setattr(pipeline, name, function)
    arguments = ["--checkpoint", str(checkpoint), "--size", "64", "--precision", "int8", "-o", str(tmp_path / "a.onnx")]
    result = CliRunner().invoke(app, arguments, env={"COLUMNS": "400"})
    assert result.exit_code == 1
    assert "refused: not enough memory to export for 64x64 px: take a smaller --size" in result.output
    assert list(tmp_path.iterdir()) == []


def test_another_error_of_torch_is_no_lack_of_memory(
    checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pipeline, "export_graph", lambda *_: torch.zeros(2).reshape(3))
    with pytest.raises(RuntimeError, match="invalid for input of size 2"):
        pipeline.export_checkpoint(checkpoint, tmp_path / "net.onnx", **QUICK)


def test_a_network_that_torch_cannot_export_is_refused_in_one_line(network: GaPMeS) -> None:
    network.forward = lambda *_: 1 // 0  # type: ignore[method-assign]
    with pytest.raises(
        ValueError, match=r"cannot export this network for 64x64 px \(ZeroDivisionError: .*\); try"
    ) as told:
        export_graph(network, 64, 64)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize(
    "last",
    [
        "RuntimeError: [enforce fail at alloc_cpu.cpp:127] . DefaultCPUAllocator: can't allocate memory: you tried to",
        "RuntimeException: [ONNXRuntimeError] : 6 : Failed to allocate memory for requested buffer of size 9",
        "numpy._core._exceptions._ArrayMemoryError: Unable to allocate 1.0 EiB for an array",
        "MemoryError",
    ],
)
def test_a_verification_without_memory_says_what_helps(last: str) -> None:
    assert pipeline._no_verdict(1, f"Traceback\n{last}\n").endswith(f"{last}; {pipeline.memory.CURE}")
    assert "memory" not in pipeline._no_verdict(1, "RuntimeError: no room")


def test_modules_of_the_working_folder_are_not_imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also a checkpoint may be named like an option."""
    (tmp_path / "onnx.py").write_text("raise RuntimeError('another onnx')")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(pipeline.VerificationBroken) as broken:
        pipeline._verify_elsewhere(Path("-a.onnx"), Path("-x.pth"), Path("-r.json"), True, lambda *_: None)
    assert "ended with 1: refused: " in str(broken.value)
    assert "-a.onnx" in str(broken.value)
