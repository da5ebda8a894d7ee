"""`gapmes doctor`: its findings on a healthy machine and on one with a fault."""

from __future__ import annotations

import errno
import json
import os
import re
from importlib.metadata import version
from pathlib import Path

import pytest
from external_model import write_external
from openvino_precisions import precisions

from gapmes.service import cli, doctor
from gapmes.service.doctor import Doctor, Finding, verdict
from gapmes.service.errors import ModelError
from gapmes.service.settings import Settings
from gapmes.service.splat import kernel_cache

NAMES = ["versions", "extras", "processor", "threads", "memory", "model", "kernels", "store", "caches", "sample"]


def run(*arguments: object) -> int:
    try:
        cli.main(["doctor", *map(str, arguments)])
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def test_a_machine_where_all_is_well(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """The sample goes the whole way; nothing is left behind."""
    assert run("--store", tmp_path / "not" / "there", "--json") == 0
    out, err = capfd.readouterr()
    document = json.loads(out)
    assert document["verdict"].startswith("works here")
    found = {finding["name"]: finding for finding in document["findings"]}
    assert list(found) == NAMES
    assert not [name for name, finding in found.items() if finding["state"] == "failure"]
    assert "tiny, 256 x 256 px, fp32" in found["model"]["text"]
    assert "dB beside the photograph" in found["sample"]["text"]
    assert "will be made" in found["store"]["text"]
    assert re.fullmatch(r"openvino: .+, video: .+, export: .+", found["extras"]["text"])
    assert re.search(r"kernels: /\S+ \([\d.]+ MB\), optimised models: /\S+ \(not there yet\)", found["caches"]["text"])
    assert err.splitlines()[-1] == document["verdict"]
    assert list(tmp_path.iterdir()) == []


def test_what_fails_keeps_nobody_from_looking_at_the_rest(
    tmp_path: Path, standin_model: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "model.onnx").write_bytes(b"none")
    assert run("--model", tmp_path / "model.onnx", "--store", tmp_path, "--json") == 1
    document = json.loads(capfd.readouterr().out)
    assert document["verdict"] == "does not work here: model, sample"
    assert [finding["name"] for finding in document["findings"]] == NAMES
    # a network that is none of ours in all but its form: its picture is not like the photograph
    findings = {finding.name: finding for finding in Doctor(Settings(model=standin_model, store=tmp_path)).findings()}
    assert findings["model"].state == "ok"
    assert findings["sample"].state == "failure"


def test_little_memory_and_disk_are_doubts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "available_memory_mb", lambda: 300.0)
    monkeypatch.setattr(doctor, "LEAST_DISK_MB", 1e15)
    monkeypatch.setattr(doctor, "cpu_limit", lambda: 1.5)
    monkeypatch.setattr(doctor, "memory_limit_mb", lambda: None)
    doubts = Doctor(Settings(store=tmp_path))
    assert doubts._memory() == ("warning", "300 MB free, no limit, 1000 are enough")
    assert doubts._store()[0] == "warning"
    assert doubts._threads()[1].endswith("a limit of 1.5 CPUs")
    monkeypatch.setattr(doctor, "available_memory_mb", lambda: 64_000.0)
    monkeypatch.setattr(doctor, "memory_limit_mb", lambda: 500.0)
    assert doubts._memory() == ("warning", "64000 MB free, a limit of 500 MB, 1000 are enough")
    monkeypatch.setattr(doctor, "available_memory_mb", lambda: None)
    assert doubts._memory()[0] == "ok"


def test_a_store_that_cannot_be_written(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def refused(**_: object) -> None:
        raise PermissionError(13, "Permission denied")

    before = list(tmp_path.iterdir())
    assert Doctor(Settings(store=tmp_path / "new"))._store()[1].endswith("MB free, will be made")
    assert list(tmp_path.iterdir()) == before
    (tmp_path / ".jobs").mkdir()
    with monkeypatch.context() as denied:
        denied.setattr(os, "access", lambda path, _: path != tmp_path / ".jobs")
        state, text = Doctor(Settings(store=tmp_path))._store()
        assert state == "failure"
        assert text.endswith(f"{tmp_path / '.jobs'} cannot be written: Permission denied")
    monkeypatch.setattr(doctor, "TemporaryDirectory", refused)
    state, text = Doctor(Settings(store=tmp_path))._store()
    assert state == "failure"
    assert "cannot be written" in text


def test_kernels_in_an_empty_folder_are_compiled_and_not_loaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The decorators make the folder, before any kernel is in it."""
    monkeypatch.setattr(kernel_cache, "KERNELS", tmp_path)
    assert Doctor(Settings(store=tmp_path))._kernels()[1].startswith("compiled in ")
    (tmp_path / "a.nbi").touch()
    assert Doctor(Settings(store=tmp_path))._kernels()[1].startswith("loaded in ")
    monkeypatch.setattr(kernel_cache, "_unkept", [OSError(errno.ENOSPC, "No space left on device")])
    state, text = Doctor(Settings(store=tmp_path))._kernels()
    assert state == "warning"
    assert text.endswith(f" s; compiled kernels cannot be kept in {tmp_path}: No space left on device")


def test_the_verdict_names_what_to_look_at() -> None:
    fine, doubt, bad = (Finding(name, state, "") for name, state in (("a", "ok"), ("b", "warning"), ("c", "failure")))
    assert verdict([fine]) == "works here"
    assert verdict([fine, doubt]) == "works here, but look at: b"
    assert verdict([bad, fine, doubt, bad]) == "does not work here: c, c"


def test_extras_and_caches_are_told_with_version_and_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "EXTRAS", {"one": "numpy", "other": "no-such-package"})
    (tmp_path / ".models" / "x").mkdir(parents=True)
    (tmp_path / ".models" / "x" / "model.onnx").write_bytes(bytes(3 * 2**20))
    looked = Doctor(Settings(store=tmp_path))
    assert looked._extras() == ("ok", f"one: numpy {version('numpy')}, other: not installed")
    assert looked._caches()[1].endswith(f"optimised models: {tmp_path / '.models'} (3.0 MB)")
    monkeypatch.setattr(kernel_cache, "ELSEWHERE", "NUMBA_CACHE_DIR: /x cannot be written")
    state, text = looked._caches()
    assert state == "warning"
    assert text.endswith("(3.0 MB); NUMBA_CACHE_DIR: /x cannot be written")


def test_further_models_are_looked_at_and_summed(tmp_path: Path, standin_model: Path) -> None:
    data = write_external(standin_model, tmp_path / "m.onnx")
    settings = Settings(models=f"base={tmp_path / 'm.onnx'}", model_bytes=2**24, store=tmp_path)
    state, text = Doctor(settings)._models()
    assert state == "ok"
    assert "base: standin, 64 x 48 px, fp32" in text
    assert text.endswith("a budget of 16 MB")
    data.write_bytes(bytes(data.stat().st_size))
    with pytest.raises(ModelError, match="has the sha256"):
        Doctor(settings)._models()


@pytest.mark.skipif("bf16" not in precisions(), reason="no OpenVINO, or it has no bf16 on this processor")
@pytest.mark.parametrize(("flags", "state"), [(["avx2"], "warning"), (["avx2", "amx_bf16"], "ok")])
def test_bf16_without_instructions_for_it_is_a_doubt(
    standin_model: Path, monkeypatch: pytest.MonkeyPatch, flags: list[str], state: str
) -> None:
    monkeypatch.setattr(doctor, "processor", lambda: ("", flags))
    found, text = Doctor(Settings(model=standin_model, engine="openvino-bf16", threads=1))._model()
    assert found == state
    assert ("bf16 is slow here" in text) is (state == "warning")
