"""`gapmes evaluate` of pictures that are not square, and of whole photographs."""

from __future__ import annotations

import json
from pathlib import Path

from evaluate_runs import run
from PIL import Image
from standin_model import METADATA, write_standin

from gapmes.export.evaluation.scores import BASELINES
from gapmes.service.shipped import sample_folder


def test_pictures_need_not_be_square(tmp_path: Path) -> None:
    """The size comes from the file, here 48 x 64 px, without being given."""
    config = {"config": json.dumps({"sh_degree": 1, "experts": 6})}
    file = write_standin(tmp_path / "wide.onnx", {**METADATA, **config})
    out = tmp_path / "report"
    assert run(sample_folder(), "--generated", 1, "--inputs", 2, "--model", file, "--twice", "--out", out) == 0
    document = json.loads((out / "report.json").read_text())
    assert [(g["kind"], g["height"], g["width"]) for g in document["groups"]] == [
        ("photographs", 48, 64),
        ("generated", 48, 64),
    ]
    photographs, generated = (g["scenes"][0]["models"]["wide"]["twice"] for g in document["groups"])
    assert photographs["side_px"] == 192  # of 256 x 192, which 4 : 3 leaves of the square
    assert generated["side_px"] == 96
    text = (out / "report.md").read_text()
    assert "photographs, 2 views, 48x64 px" in text
    assert "at 96x128 px" in text
    assert (out / "sample_2views_48x64px.png").is_file()


def test_whole_photographs_are_given_to_every_method(tmp_path: Path) -> None:
    """The sample's square photographs and a network of 48 x 64 px: pictures of 64 x 64."""
    config = {"config": json.dumps({"sh_degree": 1, "experts": 6})}
    file = write_standin(tmp_path / "wide.onnx", {**METADATA, **config})
    groups = {}
    for whole in ((), ("--whole",)):
        out = tmp_path / f"report{len(whole)}"
        given = ("--inputs", 2, "--model", file, "--twice", "--fade", 0, "--out", out)
        assert run(sample_folder(), *given, *whole) == 0
        (groups[bool(whole)],) = json.loads((out / "report.json").read_text())["groups"]
    assert [(g["whole"], g["height"], g["width"]) for g in groups.values()] == [(False, 48, 64), (True, 48, 64)]
    assert groups[True]["title"] == "photographs, 2 views, 48x64 px, whole photographs"
    assert groups[True]["scenes"][0]["models"]["wide"]["twice"]["side_px"] == 256
    for name in BASELINES:
        middle, whole = (groups[w]["scenes"][0]["baselines"][name]["all"]["psnr"] for w in (False, True))
        assert middle != whole
    names = ("report1/sample_2views_48x64px_whole.png", "report0/sample_2views_48x64px.png")
    whole_sheet, middle_sheet = (Image.open(tmp_path / name).height for name in names)
    assert whole_sheet > middle_sheet
