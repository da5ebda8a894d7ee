"""Common behaviour of all commands: results as JSON on stdout, a quiet mode with errors only, and closed or full
standard streams."""

from __future__ import annotations

import argparse
import os
import pty
import re
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest
import typer
from click.core import Command, Context
from served_process import own_port
from standin_model import write_standin

from gapmes.service.cli import app
from gapmes.service.shipped import sample_folder

QUIET, JSON = {"-q", "--quiet"}, {"--json"}
EXCUSED = {
    ("serve", "--json"): "has no result: it runs until it is stopped, and its log is JSON with GAPMES_LOG=json",
}
COMMAND = [sys.executable, "-m", "gapmes.service.cli"]


def commands() -> dict[str, Command]:
    """All of `gapmes`, those of entry points too, and `gapmes-export`."""
    from gapmes.export.cli import app as export_app

    group = typer.main.get_command(app)
    context = Context(group)
    found = {name: group.get_command(context, name) for name in group.list_commands(context)}  # type: ignore[attr-defined]
    return found | {"gapmes-export": typer.main.get_command(export_app)}


def lacking(name: str, options: set[str]) -> list[str]:
    """The required options that this command lacks without being excused."""
    return [one for one in sorted(QUIET | JSON) if one not in options and (name, one) not in EXCUSED]


def test_every_command_is_quiet_when_told_and_has_a_result_for_programs() -> None:
    found = commands()
    assert {"serve", "reconstruct", "render", "demo", "doctor", "evaluate", "gapmes-export"} <= set(found)
    for name, command in found.items():
        assert not lacking(name, {option for parameter in command.params for option in parameter.opts}), name
    assert all(name in found for name, _ in EXCUSED)


def test_a_command_without_them_is_noticed() -> None:
    assert lacking("other", {"--output"}) == ["--json", "--quiet", "-q"]
    assert lacking("serve", {"--port"}) == ["--quiet", "-q"]


def test_training_has_them_too(monkeypatch: pytest.MonkeyPatch) -> None:
    from gapmes.model.training import command

    options: set[str] = set()
    original = argparse.ArgumentParser.add_argument

    def noted(parser: argparse.ArgumentParser, *names: str, **more: object) -> argparse.Action:
        options.update(names)
        return original(parser, *names, **more)  # type: ignore[arg-type]

    monkeypatch.setattr(argparse.ArgumentParser, "add_argument", noted)
    with pytest.raises(SystemExit):
        command.main(["--help"])
    assert not lacking("training", options)


def run(*arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
    words = [*COMMAND, *map(str, arguments)]
    return subprocess.run(words, capture_output=True, text=True, env=os.environ | environment, check=False)


def test_what_libraries_warn_of_is_not_for_who_uses_a_command() -> None:
    """Such as Pillow's two lines about a photograph with damaged EXIF, which -q did not keep off stderr."""
    code = (
        "import warnings; from gapmes.service import cli, entry; cli.main = lambda: warnings.warn('so'); entry.main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr == ""


@pytest.fixture(scope="module")
def standin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A network that takes no time; the shipped one is that of `demo` and `doctor`."""
    return write_standin(tmp_path_factory.mktemp("network") / "standin.onnx")


def test_quiet_commands_say_nothing_and_still_refuse(standin: Path, tmp_path: Path) -> None:
    sample, ply = sample_folder(), tmp_path / "scene.ply"
    arguments = ("render", ply, "--cameras", sample / "cameras.json", "-o")
    for command in (
        ("reconstruct", sample, "--views", "1,5", "--model", standin, "-o", ply),
        (*arguments, tmp_path / "views", "--views", "3"),
        (*arguments, tmp_path / "film.webp", "--seconds", 0.2, "--fps", 10),
        (*arguments, tmp_path / "sheet.png", "--sheet", "--views", "3"),
        ("demo", "-o", tmp_path / "demo"),
        ("doctor", "--store", tmp_path / "store"),
    ):
        done = run(*command, "-q", KEEP="")
        assert (done.returncode, done.stdout, done.stderr) == (0, "", ""), command
    refused = run(*arguments, tmp_path / "views", "--views", "99", "--quiet")
    assert refused.returncode == 1
    assert len(refused.stderr.splitlines()) == 1
    assert refused.stderr.startswith("error: views: 99 is out of range")


@pytest.fixture(scope="module")
def ply(standin: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("manners") / "scene.ply"
    made = run("reconstruct", sample_folder(), "--views", "1,5", "--model", standin, "-o", path, "-q")
    assert made.returncode == 0
    return path


def redirected(where: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """A command of `gapmes` with its streams redirected as by a shell."""
    words = ["sh", "-c", f'exec "$0" "$@" {where}', *COMMAND, *map(str, arguments)]
    environment = os.environ | {"PYTHONUNBUFFERED": ""}
    return subprocess.run(words, capture_output=True, text=True, env=environment, check=False)


@pytest.mark.parametrize("where", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_commands_work_where_streams_are_closed(standin: Path, ply: Path, tmp_path: Path, where: str) -> None:
    """What they write goes into their files alone: no such file takes the number of a stream."""
    sample, out = sample_folder(), tmp_path / "out.ply"
    everything = ("doctor", "--store", tmp_path / "store")  # with the shipped network; once, where all are closed
    for command in (
        ("convert", ply, out, "--measure", "off"),
        ("render", ply, "--cameras", sample / "cameras.json", "-o", tmp_path / "views", "--views", "3"),
        ("reconstruct", sample, "--views", "1,5", "--model", standin, "-o", out),
        *([everything] if where.count("&-") == 3 else []),
    ):
        done = redirected(where, *command, "--json", "-q")
        assert (done.returncode, done.stderr) == (0, ""), command
        assert bool(done.stdout) == (where == "2>&-")
    assert out.read_bytes() == ply.read_bytes()
    refused = redirected(where, "convert", tmp_path / "missing.ply", out, "--json")
    assert refused.returncode == 1
    assert len(refused.stderr.splitlines()) == (where == ">&-")


def test_a_result_that_cannot_be_written_is_refused_in_one_line(ply: Path, tmp_path: Path) -> None:
    convert = ("convert", ply, tmp_path / "out.spz", "--measure", "off", "-q", "--json")
    done = redirected(">/dev/full", *convert)
    cure = "is there room, and permission to read and write there?"
    assert (done.returncode, done.stderr) == (1, f"error: stdout: No space left on device ({cure})\n")
    assert (tmp_path / "out.spz").is_file()
    refused = redirected(">/dev/full", "convert", tmp_path / "missing.ply", tmp_path / "out.ply", "--json")
    assert refused.returncode == 1
    assert refused.stderr.startswith("error: IN: ")
    assert len(refused.stderr.splitlines()) == 1
    assert redirected(">/dev/full 2>/dev/full", *convert).returncode == 1


def on_a_terminal(*arguments: object, until: str | Callable[[], bool], ending: int | None = None) -> str:
    """What a command writes to stderr when that is a terminal, up to a pattern or state; then it is told to end."""
    ours, theirs = pty.openpty()
    words = [*COMMAND, *map(str, arguments)]
    environment = os.environ | {"TERM": "xterm", "COLUMNS": "120"}
    with subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=theirs, env=environment) as process:
        os.close(theirs)
        text, deadline = "", time.monotonic() + 300
        try:
            while time.monotonic() < deadline and not (
                re.search(until, plain(text)) if isinstance(until, str) else until()
            ):
                if select.select([ours], [], [], 0.1)[0]:
                    text += os.read(ours, 65536).decode(errors="replace")
        except OSError:  # the other end is closed: it has ended
            pass
        finally:
            os.close(ours)
            if ending is not None:
                process.send_signal(ending)
            process.wait(120)
    return plain(text)


def plain(text: str) -> str:
    """Without escape sequences."""
    return re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", text)


def test_starting_the_service_shows_bars_on_a_terminal_and_none_when_quiet(tmp_path: Path) -> None:
    with own_port() as port:
        serve = ("serve", "--port", port, "--store", tmp_path)
        shown = on_a_terminal(*serve, until="Uvicorn running on", ending=signal.SIGKILL)
        shown += on_a_terminal(*serve, until="kernels", ending=signal.SIGKILL)
        assert re.search(r"import +[━╸╺ ]+ *[01]/1", shown), shown
        assert re.search(r"\d{4}-\d\d-\d\dT[\d:]+Z info +Uvicorn running on", shown), shown
        quiet = on_a_terminal(*serve, "-q", until=lambda: ready(port), ending=signal.SIGTERM)
    assert quiet == ""


def ready(port: int) -> bool:
    try:
        return httpx.get(f"http://127.0.0.1:{port}/readyz").status_code == 200
    except httpx.TransportError:
        return False


def test_a_doctor_shows_a_bar_on_a_terminal(tmp_path: Path) -> None:
    bar = r"doctor +[━╸╺ ]+ *\d+/\d+"
    shown = on_a_terminal("doctor", "--store", tmp_path, until=bar, ending=signal.SIGKILL)
    assert re.search(bar, shown), shown


def test_long_work_shows_a_bar_on_a_terminal(ply: Path, tmp_path: Path) -> None:
    cameras = sample_folder() / "cameras.json"
    arguments = ("render", ply, "--cameras", cameras, "-o", tmp_path / "film.webp", "--seconds", 1)
    shown = on_a_terminal(*arguments, until="wrote")
    assert re.search(r"render film +[━╸╺ ]+ *24/24", shown), shown
