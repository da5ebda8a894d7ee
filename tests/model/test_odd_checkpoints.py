"""Checkpoints of odd numbers, names, headers and configurations: read if their meaning is plain, else refused with
both numbers and a cure."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save, save_file
from torch import Tensor, nn

from gapmes.model.checkpoint import load_checkpoint, shipped_checkpoint
from gapmes.model.config import PRESETS, VitConfig
from gapmes.model.overflow import refuse_overflow
from gapmes.model.weights_file import CheckpointError, wrapper_of

CONFIG = PRESETS["tiny"].to_json()
GATE = "mixture.gates.expert_gate.weight"


@pytest.fixture(scope="module")
def weights() -> dict[str, Tensor]:
    return load_file(shipped_checkpoint("tiny"))


def written(path: Path, weights: dict[str, Tensor], config: str = CONFIG) -> Path:
    save_file(weights, path, metadata={"gapmes.config": config})
    return path


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float64])
def test_other_floating_point_is_read_as_float32(
    dtype: torch.dtype, weights: dict[str, Tensor], tmp_path: Path
) -> None:
    path = written(tmp_path / "a.safetensors", {name: value.to(dtype) for name, value in weights.items()})
    found = load_checkpoint(path).state_dict()[GATE]
    assert torch.equal(found, weights[GATE].to(dtype).float())


@pytest.mark.parametrize("wrapper", ["module.", "_orig_mod.", "model.", "module._orig_mod."])
def test_the_prefix_of_a_wrapper_is_taken_off(wrapper: str, weights: dict[str, Tensor], tmp_path: Path) -> None:
    path = written(tmp_path / "a.safetensors", {wrapper + name: value for name, value in weights.items()})
    assert torch.equal(load_checkpoint(path).state_dict()[GATE], weights[GATE])


def test_a_prefix_is_a_wrapper_s_if_every_name_has_it() -> None:
    assert wrapper_of(["module.a", "module.b"]) == "module."
    assert wrapper_of(["module.a", "b"]) == ""
    assert wrapper_of(["net.a", "net.b"]) == ""
    assert wrapper_of(["module.module.a"]) == "module.module."
    assert wrapper_of(["module."]) == "module."
    assert wrapper_of([]) == ""


@pytest.mark.parametrize(
    ("dtype", "bits", "said"),
    [
        ("F6_E2M3", 6, r"torch lacks a kind of numbers in it \(Dtype not understood: F6_E2M3\); save its tensors as"),
        ("F4", 4, rf"{GATE} is float4_e2m1fn_x2.*take one with float weights"),
    ],
)
def test_kinds_that_torch_cannot_convert_are_refused(
    dtype: str, bits: int, said: str, weights: dict[str, Tensor], tmp_path: Path
) -> None:
    whole = save({GATE: weights[GATE].to(torch.uint8)} | {k: v for k, v in weights.items() if k != GATE})
    length = int.from_bytes(whole[:8], "little")
    header, data = json.loads(whole[8 : 8 + length]), whole[8 + length :]
    start, end = header[GATE]["data_offsets"]
    rows, columns = weights[GATE].shape
    columns *= 2 if dtype == "F4" else 1  # torch counts its bytes, of two numbers each
    size = rows * columns * bits // 8
    for entry in header.values():
        if entry["data_offsets"][0] >= end:
            entry["data_offsets"] = [offset - (end - start) + size for offset in entry["data_offsets"]]
    header[GATE] = {"dtype": dtype, "shape": [rows, columns], "data_offsets": [start, start + size]}
    header["__metadata__"] = {"gapmes.config": CONFIG}
    text = json.dumps(header).encode()
    path = tmp_path / "a.safetensors"
    path.write_bytes(len(text).to_bytes(8, "little") + text + data[:start] + bytes(size) + data[end:])
    with pytest.raises(CheckpointError, match=said):
        load_checkpoint(path)


def test_the_bytes_of_a_shortened_or_lengthened_file_are_told(tmp_path: Path) -> None:
    whole, path = shipped_checkpoint("tiny").read_bytes(), tmp_path / "a.safetensors"
    for content, said in (
        (whole[:-1], f"cut short, with {len(whole) - 1} bytes of the {len(whole)} that its header states; download"),
        (
            whole + b"12",
            f"it has {len(whole) + 2} bytes, and its header states {len(whole)}; download or copy it again",
        ),
        (whole[:100], "it is another kind of file, or damaged: download or copy it again"),
    ):
        path.write_bytes(content)
        with pytest.raises(CheckpointError, match=said):
            load_checkpoint(path)


def changed(**values: object) -> str:
    """The configuration of tiny with other values; without a field whose value is `...`."""
    document = json.loads(CONFIG) | values
    return json.dumps({name: value for name, value in document.items() if value is not ...})


@pytest.mark.parametrize(
    ("config", "said"),
    [
        ("[" * 100_000, "gapmes.config that this version cannot build: configuration is no JSON: maximum recursion"),
        ("nonsense", "configuration is no JSON: Expecting value"),
        (changed(surplus=1), "configuration has the unknown field 'surplus': a newer version of gapmes may have"),
        (changed(semantic_vit={}), r"semantic_vit lacks hidden, .*image_size \(6 of the 6 fields it needs\)"),
        (changed(half_channels=...), r"configuration lacks half_channels \(1 of the 10 fields it needs\)"),
        (changed(depth_vit=...), "configuration lacks depth_vit"),
        (changed(preset="x" * 10_000), r"preset is 'x{1,20}\.\.\.x{1,20}', need one of"),
    ],
)
def test_configurations_that_cannot_be_read_are_refused(
    config: str, said: str, weights: dict[str, Tensor], tmp_path: Path
) -> None:
    with pytest.raises(CheckpointError, match=said):
        load_checkpoint(written(tmp_path / "a.safetensors", weights, config))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"heads": 5}, "hidden is 96, need a multiple of heads, which is 5"),
        ({"patch": 300}, "image_size is 256 px, need at least one patch, which is 300 px"),
    ],
)
def test_sizes_of_a_vit_that_do_not_go_together_are_refused(changes: dict[str, int], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        replace(PRESETS["tiny"].semantic_vit, **changes)
    assert VitConfig(hidden=4, layers=1, heads=4, patch=8, mlp_ratio=1, image_size=8).heads == 4


def test_a_network_that_cannot_compute_is_refused_and_not_traced_back() -> None:
    class Unfit(nn.Module):
        def forward(self, *given: Tensor) -> Tensor:
            return given[0].reshape(7, 11)

    with pytest.raises(
        CheckpointError, match=r"a\.pth: its network cannot compute two pictures of 64 px \(RuntimeError"
    ):
        refuse_overflow(Path("a.pth"), Unfit())


def test_a_network_without_memory_to_compute_is_not_called_unfit() -> None:
    class Large(nn.Module):
        def forward(self, *given: Tensor) -> Tensor:
            return torch.empty(2**58)

    with pytest.raises(CheckpointError, match=r"a\.pth: not enough memory to compute two pictures of 64 px") as told:
        refuse_overflow(Path("a.pth"), Large())
    assert "go together" not in str(told.value)
