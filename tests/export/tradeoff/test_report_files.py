"""The model files of a report: written to a folder of their own, and reused only if they match the request."""

from __future__ import annotations

from pathlib import Path

import onnx
import pytest
from standin_model import METADATA, write_standin

from gapmes.export.metadata import add_metadata
from gapmes.export.tradeoff import files
from gapmes.export.tradeoff.child import ChildFailed


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[Path]:
    """The files that are written: the shipped model is a stand-in, and quantising, which takes time, does nothing."""
    found: list[Path] = []
    shipped = write_standin(tmp_path / "shipped.onnx")
    real = files.write_model

    def write(model: onnx.ModelProto, path: Path) -> None:
        found.append(path)
        real(model, path)

    monkeypatch.setattr(files, "shipped_model", lambda: shipped)
    monkeypatch.setattr(files, "quantised", lambda model: model)
    monkeypatch.setattr(files, "write_model", write)
    return found


def test_a_file_of_the_user_is_neither_measured_nor_replaced(made: list[Path], tmp_path: Path) -> None:
    own = write_standin(tmp_path / "out.onnx").read_bytes()
    (tmp_path / "report").mkdir()
    (tmp_path / "report" / "int8.onnx").write_bytes(own)
    plain, small = files.quick_files(tmp_path / "report")
    assert plain.path == tmp_path / "shipped.onnx"
    assert made == [small.path] == [tmp_path / "report" / "models" / "int8.onnx"]
    assert (tmp_path / "report" / "int8.onnx").read_bytes() == own


@pytest.mark.parametrize(
    "change",
    [
        {"precision": "fp32"},
        {"height": "32"},
        {"width": "96"},
        {"config": "{}"},
        {"keep_all": "true"},
        {"weights_sha256": "1" * 64},
    ],
)
def test_only_what_says_that_it_is_the_same_is_used_again(
    change: dict[str, str], made: list[Path], tmp_path: Path
) -> None:
    for _ in range(2):
        files.quick_files(tmp_path)
    assert len(made) == 1  # the second time it was there
    target = tmp_path / "models" / "int8.onnx"
    write_standin(target, METADATA | {"precision": "int8"} | change)
    files.quick_files(tmp_path)
    assert made == [target, target]
    told = {entry.key: entry.value for entry in onnx.load(target).metadata_props}
    assert (told["gapmes.precision"], told["gapmes.height"]) == ("int8", METADATA["height"])


@pytest.mark.parametrize("content", [b"", b"text", b"\x3a\x05"])
def test_what_is_no_model_is_made_anew(content: bytes, made: list[Path], tmp_path: Path) -> None:
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "int8.onnx").write_bytes(content)
    files.quick_files(tmp_path)
    assert len(made) == 1


def test_every_export_is_asked_for_by_all_that_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file that matches one of them matches none of the others."""
    exported: list[files.ModelFile] = []
    monkeypatch.setattr(files, "quick_files", lambda _: [])
    monkeypatch.setattr(files, "_export_elsewhere", exported.extend)
    every = files.all_files(tmp_path)
    assert exported == every
    asked = [files._asked(file) for file in every]
    assert all(a != b for number, a in enumerate(asked) for b in asked[:number])
    model = onnx.load(write_standin(tmp_path / "standin.onnx"))
    del model.metadata_props[:]
    add_metadata(model, asked[0])
    for file in every:
        file.path.parent.mkdir(exist_ok=True)
        onnx.save(model, file.path)
    exported.clear()
    files.all_files(tmp_path)
    assert exported == every[1:]


def test_an_export_that_fails_is_named_and_ends_the_one_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files, "quick_files", lambda _: [])
    script = "import sys, time; sys.argv[1].endswith('top1.onnx') and sys.exit(7); time.sleep(600)"
    monkeypatch.setattr(files, "EXPORT", script)
    started = []
    real = files.subprocess.Popen
    monkeypatch.setattr(files.subprocess, "Popen", lambda *given: started.append(real(*given)) or started[-1])
    with pytest.raises(ChildFailed, match=r"the export of .*top1\.onnx ended with status 7, need 0"):
        files.all_files(tmp_path)
    assert [process.returncode < 0 for process in started] == [False, True]


def test_quantised_weights_do_not_carry_what_float32_was_measured_to_be(made: list[Path], tmp_path: Path) -> None:
    write_standin(tmp_path / "shipped.onnx", METADATA | {"tolerance": '{"means": 1e-4}'})
    told = files.quick_files(tmp_path)[1].path
    found = {entry.key: entry.value for entry in onnx.load(told).metadata_props}
    assert (found["gapmes.precision"], found["gapmes.tolerance"]) == ("int8", "{}")
