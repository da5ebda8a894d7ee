"""The full trunk's weights: from UniMatch's (GMFlow, GMDepth) or DepthSplat's published checkpoints."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from torch import Tensor, nn

from ..weights_file import wrapper_of
from .files import read_tensors
from .fit import Fit, LeftOut, Part, Recognised, fit
from .recognise import looks_like
from .sources import resolve

PARTS = ("backbone.", "transformer.")
ROOTS = ("encoder.depth_predictor.", "depth_predictor.", "")  # DepthSplat whole, its depth alone, UniMatch


def load_trunk(trunk: nn.Module, source: str | Path) -> Fit:
    """Load CNN and transformer strictly; what else the file holds is named in the report. Raises `CheckpointError`,
    and then `trunk` is unchanged."""
    found = resolve(source)
    file = read_tensors(found.path)
    wrapper = wrapper_of(file.tensors)
    roots = [wrapper + part for part in ROOTS if any(n.startswith(wrapper + part + PARTS[0]) for n in file.tensors)]
    root = roots[0] if roots else wrapper

    def names(name: str) -> tuple[Part, ...] | LeftOut | None:
        own = name.removeprefix(root)
        if name.startswith(root) and own.startswith(PARTS):
            return (Part(own),)
        return LeftOut("another part of that network than its multi-view trunk")

    layout = "UniMatch's" if root == wrapper else "DepthSplat's"
    kind = "" if roots else looks_like(found.path, file.tensors)
    held = f"It holds {kind}. " if kind else ""
    hint = held + "Expected are gmflow-scale1-…pth or gmdepth-scale1-…pth of UniMatch, or a checkpoint of DepthSplat."
    recognised = Recognised("multi-view trunk", f"{layout}, names under {root!r}", "", hint)
    expected: dict[str, Tensor] = trunk.state_dict()
    report, tensors = fit(file, expected, names, recognised=recognised)
    trunk.load_state_dict(tensors)
    return replace(report, repository=found.repository, commit=found.commit)
