"""What runs from a shell: when an environment is made anew, what counts as no network, what is said of a skip."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
SKIPPED = 77  # docker/check's own exit status for it


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
@pytest.mark.parametrize("name", ["pyproject.toml", "setup.py", "service/viewer/package-lock.json"])
@pytest.mark.parametrize("target", [".venv/.runtime", ".venv/.dev"])
def test_an_environment_is_made_anew_when_what_it_is_made_from_changes(tmp_path: Path, target: str, name: str) -> None:
    shutil.copy(ROOT / "Makefile", tmp_path)

    def touch(path: str, seconds: int) -> None:
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).touch()
        os.utime(tmp_path / path, (seconds, seconds))

    def is_up_to_date() -> bool:
        return subprocess.run(["make", "--question", target], cwd=tmp_path, check=False).returncode == 0

    for made_from in ("pyproject.toml", "setup.py", "service/viewer/package-lock.json", ".venv/bin/python"):
        touch(made_from, 1_000_000)
    touch(target, 1_000_001)
    assert is_up_to_date()
    touch(name, 1_000_002)
    assert not is_up_to_date()


@pytest.mark.parametrize(
    ("line", "status"),
    [
        ("npm error code ENOTFOUND", SKIPPED),
        ("npm error code EAI_AGAIN", SKIPPED),
        ("npm error code ETIMEDOUT", SKIPPED),
        ("npm ERR! code ECONNREFUSED", SKIPPED),
        ("Temporary failure in name resolution", SKIPPED),
        ("npm error code EINTEGRITY", 1),
        ("npm error code EUSAGE", 1),
        ("#12 3.1 the recipe has ENOTFOUND in a comment", 1),
    ],
)
def test_an_image_that_cannot_be_built_for_want_of_a_network_is_skipped(tmp_path: Path, line: str, status: int) -> None:
    """docker/check's own functions, with a docker that fails with this line in its log."""
    script = """
        set -u
        eval "$(sed -n '/^build() {/,/^}/p; /^skip() {/p; /^say() {/p; /^SKIPPED=/p' "$1/docker/check")"
        W=$2 BASE=base IMAGE=image NODE=()
        docker() { echo "$LINE"; return 1; }
        build
    """
    words = ["bash", "-c", script, "bash", str(ROOT), str(tmp_path)]
    done = subprocess.run(words, env=os.environ | {"LINE": line}, capture_output=True, text=True, check=False)
    assert done.returncode == status, done
    assert line in done.stdout
    assert ("=== SKIPPED" in done.stdout) == (status == SKIPPED)
    assert done.stderr == ""


@pytest.mark.parametrize("there", [True, False])
def test_a_run_without_the_viewer_says_so(tmp_path: Path, there: bool) -> None:
    """.ci/run with a `make` that passes and an image check that says when it was reached."""
    scripts = {"bin/make": "echo tests pass", "bin/chromium": "exit 1", "docker/check": "echo the image holds"}
    for name, text in scripts.items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(f"#!/bin/sh\n{text}\n")
        path.chmod(0o755)
    (tmp_path / ".ci").mkdir()
    shutil.copy(ROOT / ".ci/run", tmp_path / ".ci/run")
    if there:
        (tmp_path / "service/static/viewer").mkdir(parents=True)
        (tmp_path / "service/static/viewer/index.js").touch()
    path = f"{tmp_path / 'bin'}:{os.environ['PATH']}"
    done = subprocess.run(
        [tmp_path / ".ci/run"], env=os.environ | {"PATH": path}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done
    first, *said, last = done.stdout.splitlines()
    assert (first, last) == ("tests pass", "the image holds")
    assert [line.partition(":")[0] for line in said] == ([] if there else ["=== no WebGL viewer to be had"])
