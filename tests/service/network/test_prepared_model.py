"""The optimised model: the same bits, made once, and no obstacle if it cannot be made or read."""

from __future__ import annotations

import logging
import os
import time
from pathlib import Path

import numpy as np
import pytest
from cli_runs import run
from standin_model import write_standin

from gapmes.service.errors import ModelError
from gapmes.service.network import prepared_model
from gapmes.service.network.engine import Engine
from gapmes.service.shipped import sample_folder, shipped_model


def outputs(engine: Engine, views: int = 2) -> dict[str, np.ndarray]:
    rng, info = np.random.default_rng(0), engine.info
    poses = np.tile(np.eye(4, dtype=np.float32), (views, 1, 1))
    poses[:, 0, 3] = 0.1 * np.arange(views)
    lens = np.tile(np.array([[0.9, 0, 0.5], [0, 0.9, 0.5], [0, 0, 1]], np.float32), (views, 1, 1))
    images = rng.random((views, 3, info.height, info.width), np.float32)
    return engine.run(images, lens, poses, np.array([1, 20], np.float32), np.ones((views, info.patches), bool))


def mapped(path: Path) -> bool:
    """Whether this process has mapped the file into its memory."""
    return str(path) in Path("/proc/self/maps").read_text()


@pytest.mark.parametrize("threads", [1, 2])
def test_the_same_bits_and_the_weights_as_a_file(tmp_path: Path, threads: int) -> None:
    plain = Engine(threads=threads)
    expected = outputs(plain)
    for _ in range(2):
        engine = Engine(threads=threads, prepare=tmp_path)
        [folder] = [path for path in tmp_path.iterdir() if path.is_dir()]
        assert engine.info == plain.info
        assert mapped(folder / prepared_model.WEIGHTS)
        found = outputs(engine)
        assert found.keys() == expected.keys()
        for name, value in found.items():
            assert value.tobytes() == expected[name].tobytes(), name
    assert (folder / prepared_model.WEIGHTS).stat().st_size > 1_000_000
    assert folder.stat().st_mode & 0o077 == 0


def test_it_is_made_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Engine(prepare=tmp_path)
    monkeypatch.setattr(prepared_model, "_make", None)
    Engine(prepare=tmp_path)


def test_entries_that_nobody_uses_go_when_another_is_made(tmp_path: Path) -> None:
    Engine(prepare=tmp_path)
    (used,) = (path for path in tmp_path.iterdir() if path.is_dir())
    old, recent, scene = (tmp_path / (digit * 32) for digit in "01a")
    for path, days in ((old, 31), (recent, 29), (scene, 31), (used, 31)):
        if path != used:
            path.mkdir()
            for name in ("scene.ply",) if path == scene else (prepared_model.MODEL, prepared_model.DIGEST):
                (path / name).write_bytes(b"of another release")
        os.utime(path, (time.time() - 86_400 * days,) * 2)
    Engine(prepare=tmp_path)
    assert old.exists()
    write_standin(tmp_path / "other.onnx")
    Engine(tmp_path / "other.onnx", prepare=tmp_path)
    assert not old.exists()
    assert recent.exists()
    assert scene.exists()
    assert used.exists()


def test_another_version_or_file_has_one_of_its_own() -> None:
    keys = {prepared_model._key(sha, version) for sha in ("a", "b") for version in ("1", "2")}
    assert len(keys) == 4


def test_a_folder_that_cannot_be_written_is_done_without(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "file").write_text("no folder")
    engine = Engine(prepare=tmp_path / "file")
    assert engine.info == Engine().info
    assert "loaded as it is" in caplog.text


@pytest.mark.parametrize("name", [prepared_model.MODEL, prepared_model.WEIGHTS])
@pytest.mark.parametrize("damage", [b"", b"nonsense"])
def test_a_damaged_file_is_done_without_and_made_again(
    tmp_path: Path, name: str, damage: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    Engine(prepare=tmp_path)
    [folder] = [path for path in tmp_path.iterdir() if path.is_dir()]
    (folder / name).write_bytes(damage)
    with caplog.at_level(logging.WARNING):
        again = Engine(prepare=tmp_path)
    assert "damaged" in caplog.text
    assert mapped(folder / prepared_model.WEIGHTS)
    assert again.info == Engine().info


def test_what_is_no_model_is_refused_as_ever(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="cannot be loaded"):
        Engine(sample_folder() / "cameras.json", prepare=tmp_path)
    assert list(tmp_path.iterdir()) == []
    assert shipped_model().is_file()


def test_a_file_that_the_runtime_cannot_read_is_done_without(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Its sum is right, and yet it is no model: another build of the runtime may have written it."""
    Engine(prepare=tmp_path)
    [folder] = [path for path in tmp_path.iterdir() if path.is_dir()]
    (folder / prepared_model.MODEL).write_bytes(b"nonsense")
    (folder / prepared_model.DIGEST).write_text(prepared_model._digest(folder))
    assert Engine(prepare=tmp_path).info == Engine().info
    assert "damaged" in caplog.text
    assert not folder.exists()


def test_a_command_makes_it_before_the_first_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And starts nothing; what stands in its way is an error there, since that is all it is for."""
    other = write_standin(tmp_path / "other.onnx")
    store = tmp_path / "store"
    monkeypatch.setattr("uvicorn.run", None)
    # a budget that has no room for both at a time
    monkeypatch.setenv("GAPMES_MODEL_BYTES", str(shipped_model().stat().st_size))
    assert run("serve", "--prepare", "--store", store, "--models", f"b={other}", "--threads", 1, "--quiet") == 0
    folders = [path for path in (store / ".models").iterdir() if path.is_dir()]
    assert len(folders) == 2
    monkeypatch.setattr(prepared_model, "_make", None)
    for path in (shipped_model(), other):
        engine = Engine(path, threads=1, prepare=store / ".models")
        assert engine.info == Engine(path, threads=1).info


@pytest.mark.parametrize("part", [prepared_model.MODEL, prepared_model.WEIGHTS, prepared_model.DIGEST])
def test_a_part_that_is_missing_is_made_again(part: str, tmp_path: Path) -> None:
    Engine(prepare=tmp_path)
    [folder] = [path for path in tmp_path.iterdir() if path.is_dir()]
    (folder / part).unlink()
    Engine(prepare=tmp_path)
    assert {path.name for path in folder.iterdir()} == {
        prepared_model.MODEL, prepared_model.WEIGHTS, prepared_model.DIGEST
    }  # fmt: skip


def test_what_keeps_the_command_from_making_it_is_an_error(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / ".models").write_text("no folder")
    assert run("serve", "--prepare", "--store", tmp_path, "--threads", 1, "--quiet") == 1
    assert "the model is loaded as it is" in caplog.text
    assert "the model 'default' could not be optimised into" in capfd.readouterr().err


@pytest.mark.parametrize("name", ["flags", "Features"])  # as Linux calls them on x86 and on ARM
def test_another_processor_has_an_entry_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """Told by its instruction sets alone: its clock changes from one look to the next."""
    info = tmp_path / "cpuinfo"
    monkeypatch.setattr(prepared_model, "Path", lambda _: info)

    def key(flags: str, clock: int = 2400, sha256: str = "a" * 64, runtime: str = "1.27.0") -> str:
        info.write_text(f"processor\t: 0\ncpu MHz\t\t: {clock}\n{name}\t\t: {flags}\n")
        return prepared_model._key(sha256, runtime)

    keys = {key("fpu avx2"), key("fpu avx512f"), key("fpu avx2", sha256="b" * 64), key("fpu avx2", runtime="1.28.0")}
    assert len(keys) == 4
    assert key("fpu avx2", clock=900) in keys
