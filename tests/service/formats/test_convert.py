"""`gapmes convert`: its output, its report of the cost, and its refusals; `gapmes render` of every format."""

from __future__ import annotations

import json
import os
import re
import threading
from pathlib import Path

import numpy as np
import pytest
from capture_scenes import arc, write_colmap
from cli_runs import run
from PIL import Image
from ply_cases import assert_same, binary_file, columns
from test_ply_dialects import foreign, linear_opacity, scene

from gapmes.service import inspect_ply, read_gaussians, write_ply
from gapmes.service.formats.registry import FORMATS

# dB of `scene(3000)`; measured over three seeds: 50.4 (compressed.ply: few Gaussians in chunks that reach far), 60.6
# (splat) and 54.1 (spz) in the worst of three pictures.
LEAST = {"ply": 99.0, "compressed.ply": 49.0, "splat": 59.0, "spz": 53.0}


@pytest.fixture
def ply(tmp_path: Path) -> Path:
    path = tmp_path / "scene.ply"
    write_ply(path, scene(3000))
    return path


@pytest.fixture
def cameras(tmp_path: Path) -> Path:
    pose = np.eye(4)
    view = {"width": 64, "height": 48, "fx": 60.0, "fy": 60.0, "cx": 32.0, "cy": 24.0, "c2w": pose.tolist()}
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps({"views": [view]}))
    return path


def converted(capfd: pytest.CaptureFixture[str], *arguments: object) -> dict:
    """The JSON of a conversion that succeeds."""
    assert run("convert", *arguments, "--threads", 1, "--json") == 0
    return json.loads(capfd.readouterr().out)


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_is_written_and_its_cost_is_said(ply: Path, name: str, capfd: pytest.CaptureFixture[str]) -> None:
    output = ply.with_name(f"out.{name}")
    document = converted(capfd, ply, output)
    expected = FORMATS[name].write(inspect_ply(ply).gaussians)
    assert output.read_bytes() == expected.data
    assert document["to"] == {"file": str(output), "format": name, "bytes": len(expected.data)}
    assert document["from"]["bytes"] == ply.stat().st_size
    assert document["gaussians"] == {"count": 3000, "sh_degree": 0}
    assert document["warnings"] == list(expected.notes)
    assert len(document["psnr"]) == 3
    assert min(document["psnr"]) >= LEAST[name]
    assert set(document["timings"]) == {"read", "convert", "measure"}


def test_cameras_that_see_nothing_certify_nothing(ply: Path, cameras: Path, capfd: pytest.CaptureFixture[str]) -> None:
    document = json.loads(cameras.read_text())
    away = json.loads(json.dumps(document["views"][0]))
    away["c2w"][0][0] = away["c2w"][2][2] = -1.0  # turned round
    for views, values, said in (
        ([away], [None], "see nothing of the Gaussians: 0 of 1, counted from 0"),
        (
            [document["views"][0], away],
            [pytest.approx(60, abs=15), None],
            "see nothing of the Gaussians: 1 of 2, counted from 0",
        ),
    ):
        cameras.write_text(json.dumps({"views": views}))
        found = converted(capfd, ply, ply.with_name("out.splat"), "--measure", cameras)
        assert found["psnr"] == values
        assert any(said in warning for warning in found["warnings"])
    assert run("convert", ply, ply.with_name("out.splat"), "--measure", cameras, "--threads", 1) == 0
    assert re.search(r"pictures keep \d\d\.\d dB or more \(\d\d\.\d\)", capfd.readouterr().err)


@pytest.mark.parametrize("source", FORMATS)
@pytest.mark.parametrize("target", FORMATS)
def test_any_to_any(ply: Path, source: str, target: str, capfd: pytest.CaptureFixture[str]) -> None:
    first, second = ply.with_name(f"a.{source}"), ply.with_name(f"b.{target}")
    converted(capfd, ply, first, "--measure", "off")
    document = converted(capfd, first, second, "--measure", "off")
    assert (document["from"]["format"], document["to"]["format"], document["psnr"]) == (source, target, [])
    assert len(read_gaussians(second)) == 3000


def test_lines_on_a_terminal_and_cameras_of_a_file(ply: Path, cameras: Path, capfd: pytest.CaptureFixture[str]) -> None:
    output = ply.with_name("out.splat")
    assert run("convert", ply, output, "--measure", cameras) == 0
    out, err = capfd.readouterr()
    assert out == ""
    assert "3000 Gaussians in" in err
    assert "96,000 bytes, 47.0% of" in err
    assert "pictures keep" in err
    assert len(converted(capfd, ply, output, "--measure", cameras)["psnr"]) == 1


def test_cameras_that_were_passed_over_are_told(ply: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write_colmap(tmp_path, arc(3))
    write_colmap(tmp_path, arc(2), "sparse/1")
    document = converted(capfd, ply, ply.with_name("out.spz"), "--measure", tmp_path)
    assert len(document["psnr"]) == 3
    assert any("ignored: sparse/1 (2 images)" in warning for warning in document["warnings"])


def test_the_format_may_be_named(ply: Path, capfd: pytest.CaptureFixture[str]) -> None:
    unnamed, back = ply.with_name("scene.bin"), ply.with_name("back.ply")
    converted(capfd, ply, unnamed, "--to", "splat", "--measure", "off")
    assert run("convert", unnamed, back) == 1
    assert "'scene.bin' ends in none of ply, compressed.ply, splat, spz" in capfd.readouterr().err
    converted(capfd, unnamed, back, "--from", "splat", "--measure", "off")
    assert_same(read_gaussians(unnamed, format="splat"), read_gaussians(unnamed, format=".splat"))
    assert len(read_gaussians(back)) == 3000


def test_render_takes_the_format_by_name_too(ply: Path, cameras: Path, capfd: pytest.CaptureFixture[str]) -> None:
    unnamed = ply.with_name("scene.bin")
    converted(capfd, ply, unnamed, "--to", "splat", "--measure", "off")
    arguments = ("render", unnamed, "--cameras", cameras, "-o", ply.parent / "v", "--json")
    assert run(*arguments) == 1
    assert "'scene.bin' ends in none of" in capfd.readouterr().err
    assert run(*arguments, "--from", "splat") == 0
    assert json.loads(capfd.readouterr().out)["gaussians"] == 3000


@pytest.mark.parametrize(
    ("name", "option", "value"),
    [
        ("spz", "--opacity", "linear"),
        ("spz", "--rotation", "wxyz"),
        ("ply", "--axes", "rdf"),
        ("compressed.ply", "--scales", "log"),
        ("splat", "--axes", "rdf"),
    ],
)
def test_an_option_that_the_format_has_no_use_for_is_told(
    ply: Path, cameras: Path, name: str, option: str, value: str, capfd: pytest.CaptureFixture[str]
) -> None:
    source, output = ply.with_name(f"it.{name}"), ply.with_name("out.ply")
    source.write_bytes(FORMATS[name].write(scene(100)).data)
    told = f"{option.removeprefix('--')} {value} changes nothing: a .{name} has no such choice"
    plain = converted(capfd, source, output, "--measure", "off")["warnings"]
    assert converted(capfd, source, output, "--measure", "off", option, value)["warnings"] == [told, *plain]
    assert run("render", source, "--cameras", cameras, "-o", ply.parent / "v", "--json", option, value) == 0
    assert json.loads(capfd.readouterr().out)["warnings"] == [told, *plain]


def test_in_may_be_out(ply: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """The bytes that are told are those of before."""
    write_ply(ply, scene(3000), positions="float64")
    before = ply.stat().st_size
    document = converted(capfd, ply, ply, "--measure", "off")
    assert document["from"]["bytes"] == before
    assert document["to"]["bytes"] == ply.stat().st_size < before


def test_in_may_be_a_pipe(ply: Path, cameras: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """It is read once, and known by its bytes; other formats than these need a name."""
    pipe = ply.with_name("pipe")
    os.mkfifo(pipe)

    def piped(*arguments: object) -> dict:
        writer = threading.Thread(target=lambda: pipe.write_bytes(ply.read_bytes()), daemon=True)
        writer.start()
        assert run(*arguments, "--threads", 1, "--json") == 0
        writer.join(120)
        return json.loads(capfd.readouterr().out)

    converted(capfd, ply, ply.with_name("from_file.ply"), "--measure", "off")
    document = piped("convert", pipe, ply.with_name("out.ply"), "--measure", "off")
    assert document["from"] == {"file": str(pipe), "format": "ply", "bytes": ply.stat().st_size, "rows": 3000}
    assert ply.with_name("out.ply").read_bytes() == ply.with_name("from_file.ply").read_bytes()
    assert piped("render", pipe, "--cameras", cameras, "-o", ply.parent / "v")["gaussians"] == 3000
    for nothing in ("/dev/null", ply.parent):
        assert run("convert", nothing, ply.with_name("out.ply")) == 1
        assert f"IN: {nothing} is not a file" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("reach", "words"),
    [
        (1e38, r"(?<!definition\.)near: is 3\.\d+e\+37, need 0 to 1e\+37"),
        (1e101, r"means: .* would be 4\.\d+e\+101 units away, need at most 1e\+100; .* at index 0: \[1e\+101, "),
        (1.5e308, r"means: .* would be inf units away"),
    ],
)
def test_what_no_camera_can_hold_is_written_and_not_compared(
    ply: Path, reach: float, words: str, capfd: pytest.CaptureFixture[str]
) -> None:
    source = scene(50)
    source.means[::2, 0], source.means[1::2, 0] = reach, -reach
    write_ply(ply, source)
    output = ply.with_name("out.ply")
    document = converted(capfd, ply, output)
    assert document["psnr"] == []
    assert re.match(f"pictures could not be compared: {words}", document["warnings"][-1])
    assert np.array_equal(read_gaussians(output).means, read_gaussians(ply).means)


def test_a_dialect_is_said_and_may_be_told(tmp_path: Path, cameras: Path, capfd: pytest.CaptureFixture[str]) -> None:
    source, theirs, ours = scene(40), tmp_path / "theirs.ply", tmp_path / "ours.ply"
    theirs.write_bytes(foreign(source, **linear_opacity(source)))
    [warning] = converted(capfd, theirs, ours, "--measure", "off")["warnings"]
    assert "--opacity linear takes them as they are" in warning
    assert converted(capfd, theirs, ours, "--measure", "off", "--opacity", "linear")["warnings"] == []
    assert np.abs(read_gaussians(ours).opacities - source.opacities).max() <= 1e-6
    arguments = ("render", theirs, "--cameras", cameras, "-o", tmp_path / "v", "--json")
    for told, expected in (((), 1), (("--opacity", "linear"), 0)):
        assert run(*arguments, *told) == 0
        assert len(json.loads(capfd.readouterr().out)["warnings"]) == expected


def test_invalid_rows_are_refused_or_dropped(ply: Path, capfd: pytest.CaptureFixture[str]) -> None:
    table = {name: column.copy() for name, column in columns(ply.read_bytes()).items()}
    table["y"][9] = np.inf
    ply.write_bytes(binary_file(table))
    output = ply.with_name("out.spz")
    assert run("convert", ply, output, "--json") == 1
    assert json.loads(capfd.readouterr().out)["error"]["field"] == "vertex.y"
    assert not output.exists()
    document = converted(capfd, ply, output, "--drop-invalid", "--measure", "off")
    assert (document["from"]["rows"], document["gaussians"]["count"]) == (3000, 2999)
    assert document["warnings"][0] == "1 of 3000 Gaussians dropped, invalid in y (1)"


def test_what_is_refused_before_the_work(ply: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    for arguments, message in (
        (
            (ply, tmp_path / "a.obj"),
            "OUT: 'a.obj' ends in none of ply, compressed.ply, splat, spz (end it in one of them, or give --to)",
        ),
        ((ply, tmp_path / "a.ply", "--to", "obj"), "to: 'obj' is no format"),
        ((tmp_path / "none.ply", tmp_path / "a.ply"), "is not a file"),
        ((ply, tmp_path / "none" / "a.ply"), "is not a folder"),
        ((ply, tmp_path / "a.ply", "--measure", tmp_path / "none.json"), "none.json"),
    ):
        assert run("convert", *arguments) == 1
        assert message in capfd.readouterr().err


@pytest.mark.parametrize("name", FORMATS)
def test_render_draws_every_format(ply: Path, cameras: Path, name: str, capfd: pytest.CaptureFixture[str]) -> None:
    path = ply.with_name(f"it.{name}")
    path.write_bytes(FORMATS[name].write(inspect_ply(ply).gaussians).data)
    pictures = []
    for file in (ply, path):
        assert run("render", file, "--cameras", cameras, "-o", ply.parent / "v", "--threads", 1) == 0
        pictures.append(np.asarray(Image.open(ply.parent / "v" / "view_0.png")).astype(int))
    assert pictures[0].max() > 50
    assert np.abs(pictures[0] - pictures[1]).mean() < 0.5
    capfd.readouterr()


def test_a_file_without_gaussians_is_told(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """A .splat has no header: one that was cut off at its start is nothing else."""
    (tmp_path / "empty.splat").touch()
    document = converted(capfd, tmp_path / "empty.splat", tmp_path / "out.ply")
    assert document["warnings"][0] == f"{tmp_path}/empty.splat holds no Gaussian: is it the right file, and whole?"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("-", "out.ply"), "IN: - does not stand for stdin (name /dev/stdin, with --from for a .splat"),
        (("scene.ply", "out.ply", "--measure", ""), "measure: is empty, need a camera file, around or off"),
        (("scene.ply", "out.ply", "--measure", "scene.ply"), "measure: scene.ply is no"),
    ],
)
def test_inputs_that_are_none_are_told(
    ply: Path,
    arguments: tuple[str, ...],
    words: str,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(ply.parent)
    assert run("convert", *arguments) == 1
    assert f"error: {words}" in capfd.readouterr().err
