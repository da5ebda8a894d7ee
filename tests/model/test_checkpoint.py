"""Checkpoints: what is written is read back, what does not fit is named."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file
from small_networks import scene, tiny

from gapmes.model.checkpoint import CheckpointError, load_checkpoint, save_checkpoint, shipped_checkpoint


def test_round_trip_is_exact(tmp_path: Path) -> None:
    network = tiny(3)
    save_checkpoint(tmp_path / "a.safetensors", network)
    loaded = load_checkpoint(tmp_path / "a.safetensors")
    assert loaded.config == network.config
    assert all(torch.equal(a, b) for a, b in zip(network.parameters(), loaded.parameters(), strict=True))
    with torch.no_grad():
        assert torch.equal(network(*scene()).gaussians.means, loaded(*scene()).gaussians.means)
    assert [p.name for p in tmp_path.iterdir()] == ["a.safetensors"]


def test_a_file_that_does_not_fit_names_the_tensors(tmp_path: Path) -> None:
    network = tiny()
    state = {k: v.contiguous() for k, v in network.state_dict().items()}
    state["extra.weight"] = torch.zeros(1)
    del state["heads.mu.out.weight"]
    state["heads.mu.out.bias"] = torch.zeros(5)
    path = tmp_path / "wrong.safetensors"
    save_file(state, path, metadata={"gapmes.config": network.config.to_json()})
    with pytest.raises(CheckpointError, match=r"heads\.mu\.out\.weight.*extra\.weight.*\(5,\) instead of \(12,\)"):
        load_checkpoint(path)


def test_a_foreign_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "foreign.safetensors"
    save_file({"a": torch.zeros(1)}, path)
    with pytest.raises(CheckpointError, match="another network"):
        load_checkpoint(path)
    with pytest.raises(CheckpointError, match="cannot be read"):
        load_checkpoint(tmp_path / "missing.safetensors")


def test_shipped_weights_load_and_others_are_named() -> None:
    assert load_checkpoint(shipped_checkpoint("tiny")).config.preset == "tiny"
    with pytest.raises(CheckpointError, match="shipped: tiny"):
        shipped_checkpoint("base")
