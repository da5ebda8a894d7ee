"""The report of error against run time: its schema, its errors against closed forms, and its knobs, which users can
set."""

from __future__ import annotations

import json
import shlex
from dataclasses import asdict
from pathlib import Path

import numpy as np
import onnx
import pytest
from typer.testing import CliRunner

from gapmes.export.cli import app as export_app
from gapmes.export.tradeoff import files, knobs, run, scenes
from gapmes.export.tradeoff.child import Given, _in_child, peak_mb, timed
from gapmes.export.tradeoff.errors import model_error, network_rounding, setting_error, splatter_rounding
from gapmes.export.tradeoff.machine import this_machine
from gapmes.export.tradeoff.page import _front
from gapmes.export.tradeoff.scenes import load_scene
from gapmes.export.tradeoff.schema import Report
from gapmes.service.cameras.camera import Camera
from gapmes.service.cli import app
from gapmes.service.errors import InputError
from gapmes.service.leaving_out.budget import KEEP_ALL, Budget, parse_max_error
from gapmes.service.photographs.images import FittedView
from gapmes.service.pictures.effort import Effort
from gapmes.service.process.machine import FLAGS
from gapmes.service.shipped import sample_folder, shipped_model
from gapmes.service.splat import render

SIZE = 64  # px
(BUDGETED,) = (setting for setting in knobs.SCENE_SETTINGS if setting.default)


@pytest.fixture(scope="module")
def little(small_graph: onnx.ModelProto, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shipped network for little pictures."""
    path = tmp_path_factory.mktemp("network") / "little.onnx"
    onnx.save(small_graph, path)
    return path


@pytest.fixture(scope="module")
def quick(little: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Report, Path]:
    """The short report of little pictures, with fewer repeats and settings: of each knob of pictures the first and the
    last."""
    out = tmp_path_factory.mktemp("report")
    ends = {s.knob: s for s in reversed(knobs.PICTURE_SETTINGS)}, {s.knob: s for s in knobs.PICTURE_SETTINGS}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "REPEATS", 1)
        patch.setattr(run, "PICTURE_REPEATS", 1)
        patch.setattr(run, "timed", lambda model, *given: timed(model or little, *given))
        patch.setattr(scenes, "SIZE", SIZE)
        patch.setattr(files.ModelFile, "size", SIZE)
        patch.setattr(files, "quick_files", lambda _: [files.ModelFile("precision", "fp32", "", little, size=SIZE)])
        patch.setattr(run._Measure, "views", lambda *_: [])
        patch.setattr(knobs, "FADE_PASSES", (0, 4))
        patch.setattr(knobs, "SCENE_SETTINGS", (BUDGETED, knobs.SCENE_SETTINGS[-1]))
        patch.setattr(knobs, "PICTURE_SETTINGS", tuple(s for end in ends for s in end.values()))
        return run.report([sample_folder()], out, quick=True), out


def test_what_is_written_fits_the_schema(quick: tuple[Report, Path]) -> None:
    report, out = quick
    text = (out / "report.json").read_text()
    assert Report.model_validate_json(text) == report
    assert json.loads((out / "report.schema.json").read_text()) == Report.model_json_schema()
    with pytest.raises(ValueError, match="extra"):
        Report.model_validate({**json.loads(text), "more": 1})
    assert (out / "pareto.png").stat().st_size > 10_000
    table = (out / "report.md").read_text()
    assert table.count("\n| ") >= len(report.rows)
    assert report.machine.threads >= 1
    assert set(report.machine.versions) >= {"python", "numpy", "onnxruntime"}


def test_a_scene_counts_once(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="given twice"):
        run.report([sample_folder(), sample_folder() / ".." / sample_folder().name], tmp_path / "report")
    assert not (tmp_path / "report").exists()


def test_the_four_errors_stand_apart(quick: tuple[Report, Path]) -> None:
    report, _ = quick
    rows = {(row.knob, row.value): row for row in report.rows}
    plain = rows["precision", "fp32"]
    assert plain.setting is not None
    assert plain.setting.largest == 0
    assert plain.rounding is not None
    assert plain.rounding.mean > 0
    assert plain.model is not None
    assert plain.model.psnr > 24
    assert plain.peak_mb is not None
    assert 100 < plain.peak_mb < 2000
    assert set(plain.timing.stages) >= {"network", "leave out", "check"}
    assert report.splatter_rounding.p99 < 2e-6
    for row in report.rows:
        assert row.timing.seconds > 0
        if row.bound is not None:
            assert row.bound.held
            assert row.bound.actual <= row.bound.bound + 1e-6
        bounded = row.knob in ("alpha cut", "early stop", "cut radius") or "harmonics" in row.knob
        assert row.group != "picture" or (row.bound is not None) == bounded
    never, default = rows["fading", "0"], rows["fading", "4"]
    assert default.default
    assert default.model == plain.model
    assert never.model is not None
    assert never.model.psnr < plain.model.psnr
    assert never.timing.stages["fade"] < default.timing.stages["fade"]
    strided = rows["pixel stride", "4"]
    assert strided.bound is None
    budgeted = rows["leaving out", BUDGETED.value].megabytes
    assert strided.megabytes is not None
    assert budgeted is not None
    assert strided.megabytes < budgeted / 5  # one cell of sixteen, of what is not left out; measured 0.075 and 0.586
    assert rows["early stop", "0"].setting.largest == 0
    assert rows["cut radius", "none"].setting.largest == 0
    assert rows["cut radius", "none"].how == "gapmes render"


def test_the_shipped_file_rounds_little() -> None:
    found = network_rounding(files.ModelFile("precision", "fp32", "", shipped_model()), 1)
    assert 0 < found.mean < 1e-4  # measured 3e-5, and 2e-4 with little pictures, of which more is an edge


def test_changes_have_closed_forms() -> None:
    exact = [np.full((3, 4, 4), 0.5, np.float32)] * 2
    other = [exact[0], exact[0] + np.float32(0.1)]
    found = setting_error(other, exact)
    assert found.largest == pytest.approx(0.1, abs=1e-7)
    assert found.mean == pytest.approx(0.05, abs=1e-7)
    assert found.psnr == pytest.approx(-10 * np.log10(0.005), abs=1e-4)
    assert setting_error(exact, exact).psnr == 200
    camera = Camera.make(16, 16, 16, 16, 8, 8, np.eye(4))
    truth = [FittedView(np.full((3, 16, 16), 0.5, np.float32), None, camera, 1.0)] * 2
    quality = model_error([truth[0].image + np.float32(d) for d in (0.1, 0.01)], truth, None)
    assert quality.psnr == pytest.approx(30, abs=1e-3)
    assert quality.psnr_spread == pytest.approx(10, abs=1e-3)
    assert quality.lpips is None


def test_a_child_loads_the_service_alone(little: Path) -> None:
    scene = load_scene(sample_folder())
    assert sorted(scene.more) == [3, 4]
    given = Given(scene.given.photos, scene.given.cameras, scene.given.near, scene.given.far)
    found = timed(little, [given], KEEP_ALL, 1, 1)
    assert found.seconds == pytest.approx(sum(found.stages.values()), rel=1e-6)
    assert found.peak_mb < peak_mb()  # this process has torch in it
    assert "torch" not in _in_child(eval, "sorted(__import__('sys').modules)")
    camera = scene.targets[0].camera
    assert render(found.gaussians[0], camera).alpha.mean() > 0.9
    assert splatter_rounding(found.gaussians[0], camera, 0.1).largest < 2 / 255  # a pixel on a cut may jump by a layer


def test_every_knob_is_an_option_of_a_command() -> None:
    """Each row names a real option: the commands know it, and its value gives the same setting."""
    shown = CliRunner(env={"COLUMNS": "200"})
    help_of = {
        "reconstruct": shown.invoke(app, ["reconstruct", "--help"]).output,
        "render": shown.invoke(app, ["render", "--help"]).output,
        "export": shown.invoke(export_app, ["--help"]).output,
    }
    of_scene = {"--max-error": ("max_error", parse_max_error), "--min-opacity": ("min_opacity", float)}
    of_scene["--stride"] = ("stride", int)
    for setting in knobs.SCENE_SETTINGS:
        words = shlex.split(setting.how)
        given = {}
        for option, value in zip(words[::2], words[1::2], strict=True):
            assert option in help_of["reconstruct"]
            name, parse = of_scene[option]
            given[name] = parse(value)
        assert Budget(**given) == setting.budget
    of_picture = {"--alpha-min": "alpha_min", "--stop": "stop", "--sh-degree": "sh_degree", "--samples": "samples"}
    of_picture["--cut-radius"] = "cut_radius"
    for picture in knobs.PICTURE_SETTINGS:
        if not picture.how:
            assert picture.effort == Effort()
            assert picture.default
            continue
        option, value = shlex.split(picture.how)
        assert option in help_of["render"]
        found, plain = asdict(picture.effort), asdict(Effort())
        assert found.pop(of_picture[option]) == pytest.approx(float(value), rel=1e-5)  # six digits are shown
        del plain[of_picture[option]]
        assert found == plain
    for option in ("--precision", "--top-k", "--keep-all", "--size", "--report", "--stability"):
        assert option in help_of["export"]
    assert sum(setting.default for setting in knobs.SCENE_SETTINGS) == 1
    defaults = [setting.knob for setting in knobs.PICTURE_SETTINGS if setting.default]
    assert defaults == ["alpha cut", "early stop", "cut radius", "samples", knobs.BANDS]


def test_the_machine_is_named() -> None:
    machine = this_machine(3)
    assert machine.threads == 3
    assert machine.cpu
    assert set(machine.flags) <= set(FLAGS)


def test_the_front_is_what_no_other_beats_in_both() -> None:
    from matplotlib.figure import Figure

    axes = Figure().subplots()
    _front(axes, [(3.0, 30.0), (1.0, 20.0), (2.0, 19.0), (2.0, 25.0), (4.0, 30.0), (2.0, 25.0)])
    (line,) = axes.lines
    assert list(dict.fromkeys(zip(*line.get_data(), strict=True))) == [(1, 20), (2, 25), (3, 30)]
