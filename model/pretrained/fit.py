"""Strict matching of a file's tensors to a module's: each is used, or named with the reason why not, or an error."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from torch import Tensor

from ..tensor_checks import refuse_non_finite, refuse_other_kinds
from ..weights_file import CheckpointError, some
from .files import TensorFile


@dataclass(frozen=True)
class Part:
    """A target tensor is the part `index` of `of` equal parts of a file's tensor, cut along the first axis."""

    target: str
    index: int = 0
    of: int = 1


@dataclass(frozen=True)
class LeftOut:
    """A file's tensor that is known, and not wanted here."""

    reason: str


# What a tensor of the file is: the targets that it gives, known but not wanted, or unknown.
Names = Callable[[str], tuple[Part, ...] | LeftOut | None]


@dataclass(frozen=True)
class Fit:
    """What became of every tensor of a file and of every tensor of the module."""

    path: str
    sha256: str
    recognised: str  # family and size
    layout: str  # whose names the file uses
    licence: str  # that the publisher states for these weights, or "" where that is not known
    used: dict[str, str]  # target <- source, with [part/parts] where the source was cut
    left_out: dict[str, str]  # source: reason
    absent: dict[str, str]  # target that the file need not have: reason
    missing: tuple[str, ...] = ()
    unexpected: tuple[str, ...] = ()
    misshapen: tuple[str, ...] = ()  # each with both shapes
    unwrapped: tuple[str, ...] = ()
    set_aside: tuple[str, ...] = ()
    repository: str = ""  # on the hub, where it came from there
    commit: str = ""
    config_checked: bool = False  # a config.json lay beside it and agrees on what tensors cannot tell

    def summary(self) -> list[str]:
        """What was recognised, and what was not used, by reason, also what stood beside the weights in the file."""
        lines = [f"{self.recognised}, sha256 {self.sha256}: {len(self.used)} tensors used"]
        for what, names in (("left out", self.left_out), ("absent", self.absent)):
            for reason in sorted(set(names.values())):
                those = tuple(name for name, given in names.items() if given == reason)
                lines.append(f"{len(those)} {what} ({reason}): {some(those)}")
        if self.set_aside:
            lines.append(f"{len(self.set_aside)} not read (beside the weights): {some(self.set_aside)}")
        return lines

    def to_json(self) -> str:
        return json.dumps(asdict(self), indent=1, sort_keys=True)

    def write(self, path: Path) -> None:
        """As a JSON document, for the record of where weights came from."""
        path.write_text(self.to_json() + "\n")


@dataclass(frozen=True)
class Recognised:
    """What a file's tensors say of themselves, as the report and the messages word it."""

    name: str = "tensors of an unknown network"
    layout: str = "unknown"
    licence: str = ""
    hint: str = ""  # which preset or file would fit, in a sentence


def fit(
    file: TensorFile,
    expected: Mapping[str, Tensor],
    names: Names,
    *,
    recognised: Recognised,
    optional: Mapping[str, str] | None = None,
) -> tuple[Fit, dict[str, Tensor]]:
    """The report, and a tensor for every name of `expected`, in its shape and as float32.

    `optional` names targets that the file need not have, each with the reason; they keep the value in `expected`.
    Raises `CheckpointError` that lists what is missing, unexpected or misshapen (five of each and the counts) and
    what the file seems to be, and for numbers that are not finite or not in floating point.
    """
    used: dict[str, str] = {}
    left_out: dict[str, str] = {}
    unexpected: list[str] = []
    misshapen: list[str] = []
    pieces: dict[str, tuple[Tensor, Part]] = {}
    for source, value in sorted(file.tensors.items()):
        parts = names(source)
        if isinstance(parts, LeftOut):
            left_out[source] = parts.reason
        elif parts is None or any(part.target not in expected for part in parts):
            unexpected.append(source)
        elif taken := [part.target for part in parts if part.target in used]:
            unexpected.append(f"{source} (already given by {used[taken[0]]})")
        else:
            for part in parts:
                used[part.target] = source if part.of == 1 else f"{source}[{part.index}/{part.of}]"
                shape, wanted = _cut_shape(value, part), tuple(expected[part.target].shape)
                if shape == wanted:
                    pieces[part.target] = (value, part)
                else:
                    misshapen.append(_misshapen(used[part.target], value, part, wanted))
    absent = {name: reason for name, reason in (optional or {}).items() if name in expected and name not in used}
    missing = sorted(expected.keys() - used.keys() - absent.keys())
    report = Fit(
        path=file.path.name,
        sha256=file.sha256,
        recognised=recognised.name,
        layout=recognised.layout,
        licence=recognised.licence,
        used=used,
        left_out=left_out,
        absent=absent,
        missing=tuple(missing),
        unexpected=tuple(unexpected),
        misshapen=tuple(misshapen),
        unwrapped=file.unwrapped,
        set_aside=file.set_aside,
    )
    if missing or unexpected or misshapen:
        raise CheckpointError(_misfit(file, report, recognised))
    refuse_other_kinds(file.path, {name: value for name, value in file.tensors.items() if name not in left_out})
    tensors = {target: _cut(*piece) for target, piece in pieces.items()}
    refuse_non_finite(file.path, {used[name]: value for name, value in tensors.items()})
    tensors |= {name: expected[name].detach().clone() for name in absent}
    return report, tensors


def _cut_shape(value: Tensor, part: Part) -> tuple[int, ...]:
    if part.of == 1:
        return tuple(value.shape)
    if value.ndim == 0 or value.shape[0] % part.of:
        return (-1,)  # equals no shape
    return (value.shape[0] // part.of, *value.shape[1:])


def _misshapen(source: str, value: Tensor, part: Part, wanted: tuple[int, ...]) -> str:
    """A tensor of the file with its whole shape and the one that is needed."""
    if part.of > 1:  # that many of ours, one after the other
        wanted = (part.of * wanted[0], *wanted[1:])
    return f"{source} {tuple(value.shape)} instead of {wanted}"


def _cut(value: Tensor, part: Part) -> Tensor:
    rows = value.shape[0] // part.of if part.of > 1 else 0
    piece = value if part.of == 1 else value[part.index * rows : (part.index + 1) * rows]
    # A copy: what the file maps stays a file, which may be replaced while the weights are in use.
    return piece.to(torch.float32, copy=True).contiguous()


def _misfit(file: TensorFile, report: Fit, recognised: Recognised) -> str:
    kinds = (("missing", report.missing), ("unexpected", report.unexpected), ("misshapen", report.misshapen))
    said = [f"{kind} ({len(names)}): {some(names)}" for kind, names in kinds if names]
    return f"{file.path} does not fit: {'; '.join(said)}. {recognised.hint or f'It holds {recognised.name}.'}"
