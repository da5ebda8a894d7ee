"""Weights files: what is read, what is reported, and what is refused without being executed."""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import pickle
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from gapmes.model.pretrained.files import read_tensors
from gapmes.model.weights_file import CheckpointError

STATE = {"a.weight": torch.arange(6.0).reshape(2, 3), "b": torch.ones(4, dtype=torch.float16)}


class Intruder:
    """Creates a file when an ordinary pickle reader loads it."""

    def __init__(self, trace: Path) -> None:
        self.trace = trace

    def __reduce__(self) -> tuple[object, tuple[object, ...]]:
        return os.mkdir, (str(self.trace),)


def same(tensors: object) -> bool:
    assert isinstance(tensors, dict)
    return tensors.keys() == STATE.keys() and all(torch.equal(tensors[k], v) for k, v in STATE.items())


@pytest.mark.parametrize("name", ["a.safetensors", "a.pth", "a.pt", "a.bin", "a.ckpt"])
def test_every_format_gives_the_same_tensors_and_the_file_s_sha256(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    if path.suffix == ".safetensors":
        save_file(STATE, path, metadata={"format": "pt"})
    else:
        torch.save(STATE, path)
    file = read_tensors(path)
    assert same(file.tensors)
    assert file.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert (file.unwrapped, file.set_aside) == ((), ())


def test_torch_s_older_format_is_read_too(tmp_path: Path) -> None:
    torch.save(STATE, tmp_path / "old.pth", _use_new_zipfile_serialization=False)
    assert same(read_tensors(tmp_path / "old.pth").tensors)


def test_nests_are_taken_off_and_what_stood_beside_them_is_named(tmp_path: Path) -> None:
    torch.save({"epoch": 3, "optimizer_states": [{"x": STATE["b"]}], "state_dict": STATE}, tmp_path / "lightning.ckpt")
    file = read_tensors(tmp_path / "lightning.ckpt")
    assert same(file.tensors)
    assert file.unwrapped == ("state_dict",)
    assert file.set_aside == ("optimizer_states",)
    assert file.metadata == {"epoch": "3"}
    torch.save({"model": {"state_dict": STATE}}, tmp_path / "twice.pth")
    assert read_tensors(tmp_path / "twice.pth").unwrapped == ("model", "state_dict")


def test_keys_that_are_no_names_are_refused(tmp_path: Path) -> None:
    torch.save({**STATE, 3: STATE["b"]}, tmp_path / "numbered.pth")
    with pytest.raises(CheckpointError, match=r"numbered\.pth has 1 of 3 values under keys that are no names \(3\)"):
        read_tensors(tmp_path / "numbered.pth")


def test_two_sets_of_weights_in_one_file_are_ambiguous(tmp_path: Path) -> None:
    torch.save({"model": STATE, "state_dict": STATE}, tmp_path / "two.pth")
    with pytest.raises(CheckpointError, match="each of state_dict, model"):
        read_tensors(tmp_path / "two.pth")


@pytest.mark.parametrize("content", [[1, 2], {"epoch": 3}, {"a": torch.zeros(1), "b": 7}, {}])
def test_a_file_without_tensors_by_name_is_refused(content: object, tmp_path: Path) -> None:
    torch.save(content, tmp_path / "other.pth")
    with pytest.raises(CheckpointError, match=r"other\.pth holds"):
        read_tensors(tmp_path / "other.pth")


@pytest.mark.parametrize("write", ["zip", "older", "plain pickle", "plain pickle, protocol 2"])
def test_a_pickle_that_would_run_code_is_refused_and_runs_nothing(write: str, tmp_path: Path) -> None:
    trace, path = tmp_path / "was_here", tmp_path / "evil.pth"
    content = {**STATE, "x": Intruder(trace)}
    if write.startswith("plain"):
        path.write_bytes(pickle.dumps({"x": Intruder(trace)}, protocol=2 if write.endswith("2") else 4))
    else:
        torch.save(content, path, _use_new_zipfile_serialization=write == "zip")
    with pytest.raises(CheckpointError, match=r"evil\.pth.*nothing of it was run.*safetensors") as caught:
        read_tensors(path)
    assert not trace.exists()
    if write != "plain pickle":
        assert f"{os.name}.mkdir" in str(caught.value)
    # The trap is a real one: the ordinary reader falls into it.
    if write == "zip":
        torch.load(path, weights_only=False)
        assert trace.exists()


def test_objects_of_a_training_run_are_refused_by_the_name_of_their_class(tmp_path: Path) -> None:
    torch.save({"state_dict": STATE, "args": argparse.Namespace(lr=1e-4)}, tmp_path / "run.ckpt")
    with pytest.raises(
        CheckpointError, match=r"objects of argparse\.Namespace \(1 in all\).*convert it to safetensors"
    ):
        read_tensors(tmp_path / "run.ckpt")


def test_shards_are_joined_by_their_index(tmp_path: Path) -> None:
    index = shards(tmp_path)
    file = read_tensors(index)
    assert same(file.tensors)
    assert file.metadata == {"total_size": "32"}
    digests = [
        (hashlib.sha256((tmp_path / n).read_bytes()).hexdigest(), n) for n in ("m-1.safetensors", "m-2.safetensors")
    ]
    assert file.sha256 == hashlib.sha256("".join(f"{d}  {n}\n" for d, n in digests).encode()).hexdigest()


def shards(folder: Path) -> Path:
    save_file({"a.weight": STATE["a.weight"]}, folder / "m-1.safetensors")
    save_file({"b": STATE["b"]}, folder / "m-2.safetensors")
    index = folder / "model.safetensors.index.json"
    owners = {"a.weight": "m-1.safetensors", "b": "m-2.safetensors"}
    index.write_text(json.dumps({"metadata": {"total_size": 32}, "weight_map": owners}))
    return index


def test_a_broken_set_of_shards_is_refused(tmp_path: Path) -> None:
    index = shards(tmp_path)
    index.write_text(json.dumps({"weight_map": {"a.weight": "../m-1.safetensors"}}))
    with pytest.raises(CheckpointError, match="of its own folder"):
        read_tensors(index)
    index.write_text(json.dumps({"weight_map": {"a.weight": "m-1.safetensors", "c": "m-2.safetensors"}}))
    with pytest.raises(CheckpointError, match="disagree on 2 tensors: b, c"):
        read_tensors(index)
    index.write_text(json.dumps({"weight_map": {"a.weight": "m-3.safetensors"}}))
    with pytest.raises(CheckpointError, match="not beside it"):
        read_tensors(index)
    index.write_text("{}")
    with pytest.raises(CheckpointError, match="no index of shards"):
        read_tensors(index)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.pth", b"", "is empty"),
        ("a.safetensors", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "Git LFS pointer"),
        ("a.pth", b"<!DOCTYPE html><html>", "web page"),
        ("a.pth", b"no weights at all", "cannot be read as plain tensors"),
        ("a.pth", b"PK\x03\x04 cut short", "cannot be read as plain tensors"),
        ("a.safetensors", b"\x80\x02}q\x00.", "cannot be read as safetensors"),
        ("a.npz", b"PK\x03\x04", r"the ending '\.npz' is none of \.safetensors"),
    ],
)
def test_what_is_no_weights_file_is_said_so(name: str, content: bytes, said: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(CheckpointError, match=said):
        read_tensors(tmp_path / name)


def test_a_missing_file_and_a_shortened_one_are_named(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match="no such file"):
        read_tensors(tmp_path / "none.pth")
    torch.save({"a": torch.zeros(10_000)}, tmp_path / "short.pth")
    whole = (tmp_path / "short.pth").read_bytes()
    (tmp_path / "short.pth").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(CheckpointError, match=r"short\.pth.*download it again"):
        read_tensors(tmp_path / "short.pth")


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of torch, which leaves this format behind
def test_a_torchscript_program_is_refused(tmp_path: Path) -> None:
    torch.jit.trace(torch.nn.Linear(2, 2), torch.zeros(1, 2)).save(str(tmp_path / "program.pt"))
    with pytest.raises(CheckpointError, match="TorchScript program"):
        read_tensors(tmp_path / "program.pt")
