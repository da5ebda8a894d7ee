"""The mean of several runs' weights: correct up to rounding, of one network only, and recorded in the file."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import torch
from full_networks import miniature
from small_networks import tiny

from gapmes.model.checkpoint import load_checkpoint, read_metadata, save_checkpoint
from gapmes.model.network import GaPMeS
from gapmes.model.training import average
from gapmes.model.training.average import MEAN_OF, averaged, main
from gapmes.model.weights_file import CheckpointError, file_sha256


def saved(path: Path, network: GaPMeS) -> Path:
    save_checkpoint(path, network)
    return path


@pytest.fixture
def runs(tmp_path: Path) -> list[Path]:
    return [saved(tmp_path / f"{seed}.safetensors", tiny(seed)) for seed in range(3)]


def test_every_parameter_is_the_mean_in_float64(runs: list[Path]) -> None:
    networks = [dict(load_checkpoint(path).named_parameters()) for path in runs]
    for name, value in averaged(runs).named_parameters():
        exact = sum(network[name].double() for network in networks) / len(networks)
        assert torch.equal(value, exact.float()), name


def test_a_file_with_itself_stays_bit_for_bit(runs: list[Path]) -> None:
    once, twice = load_checkpoint(runs[1]), averaged([runs[1], runs[1]])
    assert all(torch.equal(a, b) for a, b in zip(once.parameters(), twice.parameters(), strict=True))


def test_the_command_writes_a_checkpoint_that_says_what_went_in(
    runs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new" / "mean.safetensors"
    assert main([str(out), *map(str, runs)]) == 0
    assert capsys.readouterr().out == f"{out}: mean of 3 files\n"
    written, wanted = load_checkpoint(out), averaged(runs)
    assert all(torch.equal(a, b) for a, b in zip(written.parameters(), wanted.parameters(), strict=True))
    assert read_metadata(out)[MEAN_OF].split(",") == [file_sha256(path) for path in runs]


def test_the_same_weights_under_another_name_are_refused(
    runs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = tmp_path / "copy.safetensors"
    copy.write_bytes(runs[1].read_bytes())
    with pytest.raises(SystemExit):
        main([str(tmp_path / "out.safetensors"), *map(str, runs), str(copy)])
    assert f"{copy} holds the same weights as {runs[1]}" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "out.safetensors").exists()


def test_a_missing_file_is_named_before_copies_are(runs: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    copy = runs[0].with_name("copy.safetensors")
    shutil.copy(runs[0], copy)
    with pytest.raises(SystemExit):
        main([str(copy.with_name("mean.safetensors")), "missing.safetensors", str(runs[0]), str(copy)])
    assert "missing.safetensors: no such file" in capsys.readouterr().err


def test_a_file_that_cannot_be_read_is_wrong_usage(
    runs: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def denied(path: Path) -> str:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(average, "file_sha256", denied)
    with pytest.raises(SystemExit, match="2"):
        main([str(tmp_path / "out.safetensors"), *map(str, runs)])
    assert f"Permission denied: '{runs[0]}'" in capsys.readouterr().err


@pytest.mark.parametrize("out", [".", ""])
def test_a_folder_is_no_place_for_the_mean(out: str, runs: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert main([out, *map(str, runs)]) == 1
    assert capsys.readouterr().err == "refused: . cannot be written: it is a folder; name another place\n"


def test_a_file_that_is_given_twice_is_refused(
    runs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    link = tmp_path / "link.safetensors"
    link.symlink_to(runs[0])
    before = runs[0].read_bytes()
    for files in ([runs[0], runs[0], runs[1]], [tmp_path / "out.safetensors", runs[0], link]):
        with pytest.raises(SystemExit):
            main(list(map(str, files)))
        assert f"{files[-1] if files[-1] == link else runs[0]} is given twice" in capsys.readouterr().err
    assert runs[0].read_bytes() == before
    assert not (tmp_path / "out.safetensors").exists()


def test_frozen_parts_stay_and_others_are_refused(tmp_path: Path) -> None:
    networks = [miniature(0), miniature(1)]
    frozen = {name: value for name, value in networks[0].named_parameters() if not value.requires_grad}
    other = saved(tmp_path / "other.safetensors", networks[1])
    networks[1].load_state_dict(frozen, strict=False)
    paths = [saved(tmp_path / f"{number}.safetensors", network) for number, network in enumerate(networks)]
    mean = dict(averaged(paths).named_parameters())
    assert len(frozen) > 100
    assert all(torch.equal(mean[name], value) for name, value in frozen.items())
    assert not torch.equal(mean["heads.mu.out.weight"], dict(networks[0].named_parameters())["heads.mu.out.weight"])
    with pytest.raises(
        CheckpointError, match=r"other\.safetensors has other frozen parts than .*0\.safetensors: \S+ differs"
    ):
        averaged([*paths, other])


def test_another_network_and_too_few_files_are_refused(
    runs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = saved(tmp_path / "other.safetensors", tiny(0, without_tasks=True))
    with pytest.raises(CheckpointError, match=r"than .*0\.safetensors: without_tasks is True, there False; only runs"):
        averaged([runs[0], other])
    with pytest.raises(CheckpointError, match="1 given, need at least 2"):
        averaged(runs[:1])
    out = tmp_path / "out.safetensors"
    with pytest.raises(SystemExit) as exit:
        main([str(out), str(runs[0]), str(tmp_path / "missing.safetensors")])
    assert exit.value.code == 2
    assert "missing.safetensors: no such file" in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize("place", ["taken/x.safetensors", "folder"])
def test_a_place_that_cannot_be_written_is_refused_in_one_line(
    place: str, runs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "taken").touch()
    (tmp_path / "folder").mkdir()
    before = set(tmp_path.iterdir())
    assert main([str(tmp_path / place), *map(str, runs[:2])]) == 1
    told = capsys.readouterr().err
    assert told.startswith(f"refused: {tmp_path / place} cannot be written: ")
    assert told.endswith("; name another place\n")
    assert told.count("\n") == 1
    assert set(tmp_path.iterdir()) == before
