"""DINOv2's own code and our ViT, loaded by our converter from the same file, give the same tokens."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from originals import checkout, import_from, randomise

from gapmes.model.backbones import VitFeatures
from gapmes.model.config import PRESETS
from gapmes.model.pretrained.dinov2 import load_vit

VARIABLE = "GAPMES_DINOV2_REPO"
MARKER = "dinov2/models/vision_transformer.py"


@pytest.mark.parametrize(("size", "chunks"), [("small", 0), ("base", 0), ("small", 4)])
def test_tokens_are_the_original_code_s(
    size: str, chunks: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = import_from(checkout(VARIABLE, MARKER), "dinov2.models.vision_transformer", monkeypatch)
    original = getattr(module, f"vit_{size}")(
        img_size=518, patch_size=14, init_values=1.0, ffn_layer="mlp", block_chunks=chunks
    ).eval()
    randomise(original, 0)
    path = tmp_path / "dinov2.pth"
    torch.save(original.state_dict(), path)
    ours = VitFeatures(PRESETS[size].semantic_vit, frozen=True).eval()
    report = load_vit(ours, path)
    assert len(report.used) == len(ours.vit.state_dict())
    assert not report.left_out
    errors = {}
    for height, width in ((518, 518), (252, 336)):
        x = torch.randn(1, 3, height, width, generator=torch.Generator().manual_seed(1))
        with torch.no_grad():
            theirs = original.forward_features(x)["x_norm_patchtokens"]
            here = ours.vit(x)[:, 1:]
        assert float(theirs.std()) > 0.1
        errors[height, width] = float((here - theirs).norm() / theirs.norm())
    print(f"{size}, {chunks} chunks: " + ", ".join(f"{k}: {v:.1e}" for k, v in errors.items()))  # noqa: T201
    assert errors[518, 518] < 1e-5
    with torch.no_grad():
        original.interpolate_offset = 0.0
        theirs = original.forward_features(x)["x_norm_patchtokens"]
    # Away from the native grid the original shifts the position embedding's samples by a tenth of a patch.
    assert float((here - theirs).norm() / theirs.norm()) < 1e-5
