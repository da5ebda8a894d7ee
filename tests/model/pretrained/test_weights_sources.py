"""Sources of weights: files, folders, and hub names, for which only the hub's cache is present."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import huggingface_hub.constants
import huggingface_hub.errors
import pytest
from layouts import SMALL, equal, random_vit, write

from gapmes.model.backbones import VitFeatures
from gapmes.model.pretrained.dinov2 import load_vit
from gapmes.model.pretrained.sources import choose, resolve
from gapmes.model.weights_file import CheckpointError

COMMIT = "0123456789abcdef0123456789abcdef01234567"


@pytest.fixture
def offline(monkeypatch: pytest.MonkeyPatch) -> None:
    """The effect of HF_HUB_OFFLINE=1, which the library reads only once, on import."""
    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_OFFLINE", True)


def cached(cache: Path, repository: str, *, revision: str = "main", commit: str = COMMIT) -> Path:
    """The snapshot folder of a repository in the hub's cache layout, empty."""
    root = cache / f"models--{repository.replace('/', '--')}"
    (root / "refs").mkdir(parents=True, exist_ok=True)
    (root / "refs" / revision).write_text(commit)
    snapshot = root / "snapshots" / commit
    snapshot.mkdir(parents=True, exist_ok=True)
    return snapshot


def test_a_file_and_a_folder_are_taken_as_they_are(tmp_path: Path) -> None:
    (tmp_path / "weights.pth").touch()
    assert resolve(tmp_path / "weights.pth").path == tmp_path / "weights.pth"
    assert resolve(str(tmp_path)).path == tmp_path / "weights.pth"
    (tmp_path / "config.json").write_text("{}")
    assert resolve(tmp_path).config == tmp_path / "config.json"


def test_a_folder_s_safetensors_come_first_then_shards_then_torch(tmp_path: Path) -> None:
    for name in ("other.pth", "pytorch_model.bin", "model.safetensors.index.json", "model.safetensors"):
        (tmp_path / name).touch()
        assert choose(tmp_path).name == name


def test_an_unclear_folder_lists_what_it_holds(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match=r"no weights file \(nothing\)"):
        choose(tmp_path)
    (tmp_path / "readme.md").touch()
    with pytest.raises(CheckpointError, match=r"no weights file \(readme\.md\)"):
        choose(tmp_path)
    for name in ("vits.pth", "vitb.pth"):
        (tmp_path / name).touch()
    with pytest.raises(CheckpointError, match=r"more than one weights file \(vitb\.pth, vits\.pth\)"):
        choose(tmp_path)


@pytest.mark.parametrize("name", ["weights/none.safetensors", "/none/at/all", "none", "a/b/c", "owner/", "-a/b"])
def test_what_is_neither_a_path_nor_a_hub_name_is_said_so(name: str) -> None:
    with pytest.raises(CheckpointError, match="no such file or folder"):
        resolve(name)
    with pytest.raises(CheckpointError, match="no such file or folder"):
        resolve(Path("owner/name"))


@pytest.mark.usefixtures("offline")
def test_a_hub_name_gives_the_cached_file_and_its_commit(tmp_path: Path) -> None:
    snapshot = cached(tmp_path, "facebook/dinov2-test")
    features = random_vit(1)
    write(snapshot / "model.safetensors", features.vit.state_dict())
    (snapshot / "config.json").write_text(json.dumps({"num_attention_heads": SMALL.heads, "layer_norm_eps": 1e-6}))
    loaded = VitFeatures(SMALL, frozen=True)
    report = load_vit(loaded, "facebook/dinov2-test", cache=tmp_path)
    assert equal(features, loaded)
    assert (report.repository, report.commit, report.licence) == ("facebook/dinov2-test", COMMIT, "Apache-2.0")


@pytest.mark.usefixtures("offline")
def test_a_revision_chooses_among_commits(tmp_path: Path) -> None:
    other = "f" * 40
    for revision, commit in (("main", COMMIT), ("v2", other)):
        (cached(tmp_path, "owner/name", revision=revision, commit=commit) / "pytorch_model.bin").touch()
    assert resolve("owner/name", cache=tmp_path).commit == COMMIT
    assert resolve("owner/name@v2", cache=tmp_path).commit == other
    assert resolve(f"owner/name@{other}", cache=tmp_path).commit == other
    with pytest.raises(CheckpointError, match=r"owner/name@v3 .*cannot be reached"):
        resolve("owner/name@v3", cache=tmp_path)


@pytest.mark.usefixtures("offline")
def test_a_repository_of_original_files_and_one_of_shards_are_read(tmp_path: Path) -> None:
    snapshot = cached(tmp_path, "owner/original")
    (snapshot / "depth_anything_v2_vits.pth").touch()
    assert resolve("owner/original", cache=tmp_path).path.name == "depth_anything_v2_vits.pth"
    snapshot = cached(tmp_path, "owner/sharded")
    index = snapshot / "model.safetensors.index.json"
    index.write_text(json.dumps({"weight_map": {"a": "model-1.safetensors"}}))
    with pytest.raises(CheckpointError, match=r"model-1\.safetensors, which neither"):
        resolve("owner/sharded", cache=tmp_path)
    (snapshot / "model-1.safetensors").touch()
    assert resolve("owner/sharded", cache=tmp_path).path == index


@pytest.mark.usefixtures("offline")
def test_without_a_connection_the_cure_is_named(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match=r"owner/none .*cannot be reached.*hf download owner/none"):
        resolve("owner/none", cache=tmp_path)
    cached(tmp_path, "owner/bare").joinpath("config.json").write_text("{}")
    with pytest.raises(CheckpointError, match=r"owner/bare .*cannot be reached"):
        resolve("owner/bare", cache=tmp_path)


def test_of_several_files_on_the_hub_none_is_downloaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A repository with one file in torch's format gives it; one with two is refused by their names alone."""
    asked: list[str] = []

    def download(_: str, name: str, **options: object) -> str:
        asked.append(name)
        if not name.endswith(".pth"):
            raise huggingface_hub.errors.EntryNotFoundError(name)
        (tmp_path / name).touch()
        return str(tmp_path / name)

    there = ["README.md", "small.pth", "old/other.pth"]
    monkeypatch.setattr(huggingface_hub, "hf_hub_download", download)
    monkeypatch.setattr(huggingface_hub, "list_repo_files", lambda *_, **__: there)
    assert resolve("owner/name").path == tmp_path / "small.pth"
    there.append("large.pth")
    asked.clear()
    with pytest.raises(
        CheckpointError, match=r"owner/name holds more than one weights file \(large\.pth, small\.pth\)"
    ):
        resolve("owner/name")
    assert not any(name.endswith(".pth") for name in asked)


def test_the_hub_s_own_settings_are_obeyed(tmp_path: Path) -> None:
    (cached(tmp_path, "owner/name") / "model.safetensors").touch()
    code = "from gapmes.model.pretrained.sources import resolve; print(resolve('owner/name').path)"
    environment = {**os.environ, "HF_HUB_OFFLINE": "1", "HF_HUB_CACHE": str(tmp_path)}
    result = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert Path(result.stdout.strip()).parent.name == COMMIT
