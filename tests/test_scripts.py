"""Shell scripts: when an environment is rebuilt, which failures count as no network, and how skipping is reported."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
SKIPPED = 77  # docker/check's own exit status for it
RETRY = "WARNING: Retrying (Retry(total={}, connect=None)) after connection broken by 'NewConnectionError'"  # pip's


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
        ("#12 3.1 ERROR: No matching distribution found for numpy==0.0.1", 1),
        (f"#12 3.1 {RETRY.format(4)}\n#12 9.9 ERROR: No matching distribution found for numpy==0.0.1", 1),
        (f"#12 3.1 {RETRY.format(0)}\n#12 9.9 ERROR: No matching distribution found for numpy==2.4.4", SKIPPED),
        ("#12 3.1 ERROR: Could not install: HTTPSConnectionPool(host='pypi.org'): Max retries exceeded", SKIPPED),
        ("#12 3.1 COPY Connection.txt", 1),
        ("#7 1.1 npm error code ECONNRESET\n#12 3.1 no such option\n#12 ERROR: process did not complete", 1),
        ("#7 1.1 npm error code ECONNRESET\n#7 ERROR: process did not complete", SKIPPED),
        ("#3 ERROR: failed to resolve source metadata for docker.io/library/python", SKIPPED),
    ],
)
def test_an_image_that_cannot_be_built_for_want_of_a_network_is_skipped(tmp_path: Path, line: str, status: int) -> None:
    """docker/check's own functions, with a docker that fails with this line in its log."""
    script = """
        set -u
        eval "$(sed -n '/^build() {/,/^}/p; /^skip() {/p; /^say() {/p; /^SKIPPED=/p' "$1/docker/check")"
        eval "$(sed -n '/^no_network() {/,/^}/p' "$1/docker/check")"
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


@pytest.mark.parametrize(
    ("states", "attempts", "said"),
    [
        ("queued running running done", 2, "killed after running\n"),
        ("queued done", 1, "the job is done"),
        ("running running done", 1, "does not hold: [ 1 = 2 ]"),
        ("running running failed", 2, "the job is failed"),
    ],
)
def test_a_job_that_is_killed_must_have_been_running_and_be_tried_again(
    tmp_path: Path, states: str, attempts: int, said: str
) -> None:
    """docker/check's own functions, with a service whose job is found in one of these states after the other."""
    script = """
        set -eu
        eval "$(sed -n '/^a_job_survives_a_kill() {/,/^}/p; /^reaches() {/,/^}/p' "$1/docker/check")"
        eval "$(sed -n '/^member() {/p; /^hold() {/p; /^say() {/p' "$1/docker/check")"
        SAMPLE=sample URL=http://service NAME=name
        start() { :; }; healthy() { :; }; sleep() { :; }
        docker() { [ "$1" != kill ] || echo "killed after $(cat seen)" >&2; }
        curl() {
          head -1 states >seen
          [ "$(wc -l <states)" = 1 ] || sed -i 1d states
          printf '{"id": "x", "state": "%s", "attempts": %s}' "$(cat seen)" "$ATTEMPTS"
        }
        a_job_survives_a_kill
    """
    (tmp_path / "states").write_text("posted\n" + states.replace(" ", "\n") + "\n")
    words = ["bash", "-c", script, "bash", str(ROOT)]
    environment = os.environ | {"ATTEMPTS": str(attempts)}
    done = subprocess.run(words, env=environment, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert said in done.stdout + done.stderr
    assert done.returncode == (0 if said.startswith("killed") else 1), done


@pytest.mark.parametrize("there", [True, False])
def test_a_run_without_the_viewer_says_so(tmp_path: Path, there: bool) -> None:
    """.ci/run with a `make` that passes and an image check that says when it was reached."""
    browser = "bin/chromium-headless-shell"
    scripts = {"bin/make": "echo tests pass", browser: "exit 1", "docker/check": "echo the image holds"}
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
    assert [line.partition(":")[0] for line in said] == ([] if there else ["=== the WebGL viewer is missing"])
