"""Where a path leads: open streams are written to without loss, links are followed or refused by name."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from capture_scenes import arc, write_cameras_json
from cli_runs import assert_refusal, run
from clouds import cloud

from gapmes.service import write_ply
from gapmes.service.process import places
from gapmes.service.process.disk import replace_file, replacing, write_file

COMMAND = f"{sys.executable} -m gapmes.service.cli"
CONVERT = f"{COMMAND} convert scene.ply /dev/stdout --to splat --measure off -q"
RENDER = ("render", "scene.ply", "--cameras", "cameras.json", "-o")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    write_cameras_json(tmp_path, arc(2))
    write_ply(tmp_path / "scene.ply", cloud(300, 3, degree=0))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def shell(command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)


def test_a_file_that_stdout_leads_to_loses_nothing(folder: Path) -> None:
    assert run("convert", "scene.ply", "x.splat", "--measure", "off", "-q") == 0
    made = (folder / "x.splat").read_bytes()
    (folder / "log").write_bytes(b"as it was\n")
    done = shell(f"{CONVERT} >> log; {{ echo header; {CONVERT}; echo trailer; }} > group")
    assert (done.stderr, done.stdout) == ("", "")
    assert (folder / "log").read_bytes() == b"as it was\n" + made
    assert (folder / "group").read_bytes() == b"header\n" + made + b"trailer\n"


@pytest.mark.parametrize("where", ["> out", "| cat > out"])
def test_a_result_as_json_does_not_go_where_the_file_does(folder: Path, where: str) -> None:
    done = shell(f"{CONVERT} --json {where}; exit ${{PIPESTATUS[0]}}")
    assert done.returncode == 1
    assert done.stderr == "error: output: /dev/stdout is where --json writes to (leave --json out, or name a file)\n"
    assert list(json.loads((folder / "out").read_text())) == ["error"]


def test_streams_by_number_are_written_to_where_they_are(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"as it was")
    with (tmp_path / "file").open("ab") as file:
        for folder in ("/dev/fd", "/proc/self/fd", f"/proc/{os.getpid()}/fd", "/proc/thread-self/fd"):
            stream = Path(folder) / str(file.fileno())
            assert places.takes_bytes(stream)
            replace_file(stream, b", one")
            with replacing(stream) as part:
                write_file(part, b", two")
    assert (tmp_path / "file").read_bytes() == b"as it was" + 4 * b", one, two"
    assert not places.takes_bytes(tmp_path / "file")


def test_the_stream_of_another_process_is_added_to(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"as it was")
    with (tmp_path / "file").open("ab") as file, subprocess.Popen(["sleep", "600"], stdout=file) as other:
        replace_file(Path(f"/proc/{other.pid}/fd/1"), b", and more")
        other.kill()
    assert (tmp_path / "file").read_bytes() == b"as it was, and more"


def test_links_in_a_circle_are_refused(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    Path("one").symlink_to("two")
    Path("two").symlink_to("one")
    assert run("convert", "scene.ply", "one", "--to", "spz", "--measure", "off", "--json") == 1
    assert_refusal(capfd, "error: output: one is a link that leads to itself (remove it)")
    assert run(*RENDER, "one", "--json") == 1
    assert_refusal(capfd, "one is a link to two, which is no folder")
    with pytest.raises(OSError, match="one") as caught:
        replace_file(Path("one"), b"")
    assert caught.value.errno == errno.ELOOP


def test_a_link_to_nowhere_is_named_before_the_work(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    target = folder / "none" / "x.spz"
    Path("link.spz").symlink_to(target)
    Path("pictures").symlink_to("none")
    assert run("convert", "scene.ply", "link.spz", "--measure", "off", "--json") == 1
    assert_refusal(capfd, f"link.spz is a link to {target}, whose folder does not exist (make it, or remove the link)")
    for output in ("pictures", "pictures/deep"):
        assert run(*RENDER, output, "--json") == 1
        assert_refusal(capfd, "pictures is a link to none, which is no folder (make it, or remove the link)")


def test_a_file_that_is_a_mount_is_refused_before_the_work(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    mounted = folder / "a b.spz"
    mounted.write_bytes(b"as it was")
    written = str(mounted).replace(" ", "\\040")
    (folder / "mounts").write_text(f"22 1 0:21 / / rw - overlay x rw\n23 22 8:1 /x {written} rw - ext4 /dev/sda rw\n")
    monkeypatch.setattr(places, "MOUNTS", folder / "mounts")
    assert run("convert", "scene.ply", mounted, "--measure", "off", "--json") == 1
    assert_refusal(capfd, "a mount of its own, and no new file can take its place (mount its folder)")
    assert mounted.read_bytes() == b"as it was"
    assert run("convert", "scene.ply", folder / "b.spz", "--measure", "off", "-q") == 0
