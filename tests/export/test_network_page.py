"""docs/network.md agrees with the code: every metadata key, the planes of the sweep, the terms of the loss."""

from __future__ import annotations

import re
from pathlib import Path

from gapmes.export.metadata import contract_metadata
from gapmes.export.model_file import DIGEST
from gapmes.model.config import PRESETS
from gapmes.model.network import GaPMeS
from gapmes.model.training.recipe import Recipe

PAGE = " ".join((Path(__file__).parents[2] / "docs" / "network.md").read_text(encoding="utf-8").split())


def test_every_key_of_the_metadata_is_named(network: GaPMeS) -> None:
    told = re.search(r"Metadata under `gapmes\.\*`: (.*?) A file whose graph", PAGE)
    assert told is not None
    metadata = contract_metadata(network, height=64, width=64, weights_sha256="", licence="MIT", precision="fp32")
    named = set(re.findall(r"`([a-z_0-9]+)`", told[1]))
    assert named == {*metadata, "tolerance", "keep_all", DIGEST}


def test_planes_and_weights_of_the_loss_are_those_of_the_code() -> None:
    planes = {name: config.depth_planes for name, config in PRESETS.items()}
    assert planes == {"tiny": 64, "small": 64, "base": 128}
    assert "64 planes (`base`: 128)" in PAGE
    recipe = Recipe()
    first, last = recipe.depth_weight
    assert f"{recipe.ssim_weight:g} SSIM, depth in normalised inverse depth (from {first:g} down to {last:g})" in PAGE
    assert f"{recipe.balance_weight:g} times the balance of the experts' load" in PAGE
