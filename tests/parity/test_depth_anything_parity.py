"""Depth-Anything-V2's own code and ours, loaded by our converter from the same file, give the same depth."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from originals import checkout, import_from, randomise, relative

from gapmes.model.backbones import DepthAnythingFeatures
from gapmes.model.config import PRESETS
from gapmes.model.pretrained.depth_anything import load_depth_anything

VARIABLE = "GAPMES_DEPTH_ANYTHING_REPO"
MARKER = "depth_anything_v2/dpt.py"


@pytest.fixture(params=["vits", "vitb"])
def pair(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> tuple[torch.nn.Module, DepthAnythingFeatures]:
    """The original with random weights, and ours loaded from the file that it saves."""
    dpt = import_from(checkout(VARIABLE, MARKER), "depth_anything_v2.dpt", monkeypatch)
    small = request.param == "vits"
    config = PRESETS["small" if small else "base"].depth_vit
    channels = [48, 96, 192, 384] if small else [96, 192, 384, 768]
    original = dpt.DepthAnythingV2(encoder=request.param, features=64 if small else 128, out_channels=channels).eval()
    randomise(original, 0)
    path = tmp_path / f"depth_anything_v2_{request.param}.pth"
    torch.save(original.state_dict(), path)
    ours = DepthAnythingFeatures(config, frozen=True).eval()
    report = load_depth_anything(ours, path)
    assert len(report.used) == len(ours.model.state_dict())
    assert not report.left_out
    return original, ours


def test_depth_is_the_original_code_s_at_its_own_grid(pair: tuple[torch.nn.Module, DepthAnythingFeatures]) -> None:
    original, ours = pair
    x = torch.randn(1, 3, 518, 518, generator=torch.Generator().manual_seed(1))
    with torch.no_grad():
        theirs, here = original(x), ours.model(x)[1][:, 0]
    assert float(theirs.std()) > 0.1 * float(theirs.mean()), "a constant depth compares nothing"
    error = relative(here, theirs)
    print(f"518 x 518: {error:.1e} of the deviation {float(theirs.std()):.3g}")  # noqa: T201
    assert error < 1e-4
    assert float((here - theirs).norm() / theirs.norm()) < 1e-5


def test_at_another_size_only_the_position_embedding_is_sampled_otherwise(
    pair: tuple[torch.nn.Module, DepthAnythingFeatures],
) -> None:
    """The original samples it by a scale of (n + 0.1) / 37, ours by n / 37; the rest is the same."""
    original, ours = pair
    x = torch.randn(1, 3, 252, 336, generator=torch.Generator().manual_seed(2))
    encoder = original.pretrained
    with torch.no_grad():
        here = ours.model(x)[1][:, 0]
        published = float((here - original(x)).norm() / here.norm())
        encoder.interpolate_offset = 0.0
        without_offset = float((here - original(x)).norm() / here.norm())
        encoder.interpolate_offset = 0.1
        tokens = torch.zeros(1, 1 + 18 * 24, encoder.embed_dim)
        theirs = encoder.interpolate_pos_encoding(tokens, 252, 336)
        ours.vit.embeddings.constant = theirs
        same_embedding = float((ours.model(x)[1][:, 0] - original(x)).norm() / here.norm())
    print(f"252 x 336: {published:.1e} as published, {without_offset:.1e} without the offset")  # noqa: T201
    assert without_offset < 1e-5
    assert same_embedding < 1e-5
