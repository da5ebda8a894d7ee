"""The picture of training samples."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gapmes.model.training import textures
from gapmes.model.training.gallery import main
from gapmes.model.training.scenes import SceneSampler
from gapmes.model.training.textures import TextureAtlas


def test_it_shows_both_inputs_of_each_scene_beside_its_depth(tmp_path: Path) -> None:
    out = tmp_path / "gallery.png"
    assert main(["--out", str(out), "--rows", "2", "--columns", "1", "--size", "32", "--seed", "5"]) == 0
    picture = np.asarray(Image.open(out)).astype(float) / 255
    assert picture.shape == (64, 96, 3)
    sampler = SceneSampler(5, "train")
    for row in range(2):
        scene = sampler.batch(1, 2, 1, 32)
        shown = picture[32 * row : 32 * row + 32]
        for view in range(2):
            np.testing.assert_allclose(
                shown[:, 32 * view : 32 * view + 32], scene.images[0, view].transpose(1, 2, 0), atol=0.51 / 255
            )
        depth = scene.depths[0, 0]
        near, far = shown[:, 64:][depth == depth.min()], shown[:, 64:][depth == depth.max()]
        assert near.mean() > far.mean()


@pytest.mark.parametrize("out", ["missing/gallery.png", "gallery.txt"])
def test_a_place_that_cannot_be_written_is_refused_in_one_line(
    out: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--out", str(tmp_path / out), "--rows", "1", "--columns", "1", "--size", "16"]) == 1
    told = capsys.readouterr().err
    assert told.startswith(f"refused: {tmp_path / out} cannot be written: ")
    assert told.count("\n") == 1


def test_a_cache_that_cannot_be_made_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "taken").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "taken"))
    monkeypatch.setattr(textures, "build_atlas", lambda _: TextureAtlas(np.empty((0, 0)), np.empty(0)))
    assert main(["--out", str(tmp_path / "gallery.png"), "--rows", "1", "--columns", "1", "--size", "16"]) == 1
    told = capsys.readouterr().err
    assert told.startswith("refused: ")
    assert str(tmp_path / "taken") in told
    assert told.count("\n") == 1


def test_numbers_out_of_range_are_wrong_usage(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--out", "x.png", "--rows", "0"])
    assert "--rows: is 0, need at least 1" in capsys.readouterr().err
