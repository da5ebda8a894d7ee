"""Tensors out of a weights file, safetensors or torch's own format, without ever running what the file says."""

from __future__ import annotations

import hashlib
import json
import re
import warnings
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ..allocation import lacks_memory
from ..weights_file import CheckpointError, file_sha256, some, why_no_file
from .safetensors_file import read_safetensors

SAFETENSORS = ".safetensors"
INDEX = ".safetensors.index.json"
TORCH = (".pth", ".pt", ".bin", ".ckpt")
EXPORTED = ".onnx"
NESTS = ("state_dict", "model_state_dict", "model")  # under which trainers put the weights (Lightning: the first)
DEEPEST = 4  # nests within each other; a file can nest without end
CONVERT = "convert it to safetensors where you trust it (safetensors.torch.save_file of its tensors), and load that"


@dataclass(frozen=True)
class TensorFile:
    """What a weights file holds, and enough to say later which file it was."""

    path: Path  # the file, or the index of a sharded one
    sha256: str  # of the file; of the lines "<sha256>  <name>" of its files, by name, where it is sharded
    tensors: Mapping[str, Tensor]
    metadata: Mapping[str, str]  # the file's own: safetensors metadata, or plain values beside the weights
    unwrapped: tuple[str, ...] = ()  # the nests that the weights lay in, outermost first
    set_aside: tuple[str, ...] = ()  # what stood beside a nest and was not read, for example an optimizer's state


def read_tensors(path: Path) -> TensorFile:
    """Every tensor of a `.safetensors`, `.safetensors.index.json`, `.pth`, `.pt`, `.bin` or `.ckpt` file, on the CPU.

    Raises `CheckpointError` when there is no such file, when it is no weights file, when it is cut short, or when it
    wants to create anything but tensors and plain values; nothing of such a file is executed.
    """
    if not path.is_file():
        raise CheckpointError(why_no_file(path))
    _refuse_placeholders(path)
    if path.name.endswith(INDEX):
        return _read_shards(path)
    if path.suffix == SAFETENSORS:
        tensors, metadata = read_safetensors(path)
        return TensorFile(path, file_sha256(path), tensors, metadata)
    if path.suffix in TORCH:
        return _read_torch(path)
    if path.suffix == EXPORTED:
        raise CheckpointError(f"{path} is an exported network, which cannot be read back: give what it was made from")
    raise CheckpointError(f"{path}: the ending {path.suffix!r} is none of {', '.join((SAFETENSORS, INDEX, *TORCH))}")


def _refuse_placeholders(path: Path) -> None:
    """What a failed download leaves under the right name."""
    with path.open("rb") as file:
        head = file.read(64)
    if not head:
        raise CheckpointError(f"{path} is empty; download it again")
    if head.startswith(b"version https://git-lfs"):
        raise CheckpointError(f"{path} is a Git LFS pointer, not the weights; run `git lfs pull` in its folder")
    if head.lstrip().lower().startswith((b"<!doctype", b"<html")):
        raise CheckpointError(f"{path} is a web page, not the weights; download the file itself")


def _read_shards(index: Path) -> TensorFile:
    try:
        document = json.loads(index.read_text())
        owners: dict[str, str] = dict(document["weight_map"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise CheckpointError(f"{index} is no index of shards: {error!r}") from error
    tensors: dict[str, Tensor] = {}
    lines = []
    for name in shard_names(index, owners):
        shard = index.parent / name
        if not shard.is_file():
            raise CheckpointError(f"{index} names the shard {name}, which is not beside it; download it too")
        _refuse_placeholders(shard)
        held, _ = read_safetensors(shard)
        wrong = sorted({key for key, owner in owners.items() if owner == name} ^ held.keys())
        if wrong:
            raise CheckpointError(f"{shard} and {index.name} disagree on {len(wrong)} tensors: {', '.join(wrong[:5])}")
        tensors |= held
        lines.append(f"{file_sha256(shard)}  {name}\n")
    digest = hashlib.sha256("".join(lines).encode()).hexdigest()
    metadata = document.get("metadata")
    plain = {k: str(v) for k, v in metadata.items()} if isinstance(metadata, dict) else {}
    return TensorFile(index, digest, tensors, plain)


def shard_names(index: Path, owners: Mapping[str, str]) -> list[str]:
    """The files that an index names, sorted; raises `CheckpointError` for a name that leaves the index's folder."""
    for name in owners.values():
        if not isinstance(name, str) or Path(name).name != name or not name.endswith(SAFETENSORS):
            raise CheckpointError(f"{index} names the shard {name!r}, which is no safetensors file of its own folder")
    return sorted(set(owners.values()))


def _read_torch(path: Path) -> TensorFile:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of pickle protocols and TorchScript; what matters is raised
            # Only files in the zip format can be mapped; the older format is read whole.
            content = torch.load(path, map_location="cpu", weights_only=True, mmap=zipfile.is_zipfile(path))
    except Exception as error:  # a damaged file makes the restricted reader fail in any of a dozen ways
        raise CheckpointError(_refusal(path, error)) from error
    weights, metadata, unwrapped, set_aside = _unwrap(path, content)
    return TensorFile(path, file_sha256(path), weights, metadata, unwrapped, set_aside)


def _refusal(path: Path, error: Exception) -> str:
    if lacks_memory(error):
        return f"not enough memory to read {path}, of {path.stat().st_size} bytes: take a machine with more"
    try:
        objects = torch.serialization.get_unsafe_globals_in_checkpoint(path)
    except Exception:  # not in the zip format, or damaged: then the message says what there is to say
        objects = re.findall(r"GLOBAL (\w+(?:\.\w+)+)", str(error))
    if objects:
        wanted = ", ".join(objects[:5])
        return (
            f"{path} wants to create objects of {wanted} ({len(objects)} in all), which runs code of the file's "
            f"choice; it was not loaded, and nothing of it was run. Cure: {CONVERT}"
        )
    if "TorchScript" in str(error):
        return f"{path} is a TorchScript program, not a file of weights; it was not loaded. Cure: {CONVERT}"
    if _is_zip_cut_short(path):
        return (
            f"{path} cannot be read as plain tensors: it is cut short, as its {path.stat().st_size} bytes lack the "
            "directory that ends such a file; download it again"
        )
    lines = [line for line in str(error).splitlines() if line.strip()]
    reason = next((line for line in lines if "Unsupported operand" in line), lines[0][:200] if lines else "")
    return (
        f"{path} cannot be read as plain tensors ({type(error).__name__}: {reason}); nothing of it was run. "
        f"It is damaged, so download it again, or a pickle of another kind: {CONVERT}"
    )


def _is_zip_cut_short(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(4) == b"PK\x03\x04" and not zipfile.is_zipfile(path)


def _unwrap(path: Path, content: Any) -> tuple[dict[str, Tensor], dict[str, str], tuple[str, ...], tuple[str, ...]]:
    unwrapped: list[str] = []
    set_aside: list[str] = []
    metadata: dict[str, str] = {}
    while len(unwrapped) <= DEEPEST:
        if not isinstance(content, dict):
            raise CheckpointError(f"{path} holds a {type(content).__name__}, not tensors by name")
        nests = [key for key in NESTS if isinstance(content.get(key), dict)]
        if not nests:
            break
        if len(nests) > 1:
            raise CheckpointError(f"{path} holds weights under each of {', '.join(nests)}; save the one that is meant")
        for key, value in content.items():
            if isinstance(value, (str, int, float, bool)):
                metadata[str(key)] = str(value)
            elif key != nests[0]:
                set_aside.append(".".join([*unwrapped, str(key)]))
        unwrapped.append(nests[0])
        content = content[nests[0]]
    else:
        raise CheckpointError(
            f"{path} nests its weights more than {DEEPEST} deep: {'.'.join(unwrapped)}; save the tensors alone"
        )
    if unnamed := [key for key in content if not isinstance(key, str)]:
        shown = ", ".join(repr(key)[:50] for key in unnamed[:5])
        raise CheckpointError(
            f"{path} has {len(unnamed)} of {len(content)} values under keys that are no names ({shown}); "
            "save the tensors by their names, as a state_dict has them"
        )
    tensors = {key: value for key, value in content.items() if isinstance(value, Tensor)}
    others = [str(key) for key, value in content.items() if not isinstance(value, Tensor)]
    if others or not tensors:
        place = f" under {'.'.join(unwrapped)}" if unwrapped else ""
        raise CheckpointError(
            f"{path} holds {len(tensors)} tensors{place} and {len(others)} other values "
            f"({some(others)}); the weights were looked for at the top and under {', '.join(NESTS)}: "
            "save the one state_dict that is meant, by itself"
        )
    odd = [name for name, value in tensors.items() if not _is_plain(value)]
    if odd:
        raise CheckpointError(
            f"{path}: {some(odd)} ({len(odd)} of {len(tensors)}) are sparse, nested, quantised or on the meta device; "
            "save them as plain tensors"
        )
    return tensors, metadata, tuple(unwrapped), tuple(set_aside)


def _is_plain(value: Tensor) -> bool:
    """Whether it is dense and has its numbers with it."""
    return value.layout is torch.strided and not (value.is_nested or value.is_quantized or value.is_meta)
