"""The peak memory of a reconstruction from two photographs, by the command and by the service."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from http_requests import post
from served_process import serving

from gapmes.service.kernels import warm_up
from gapmes.service.shipped import sample_folder, shipped_model

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads Linux's /proc")
MOST_BYTES = 400e6
PROGRAM = """
from gapmes.service.cli import main
try:
    main()
finally:
    with open("/proc/self/status") as file:
        print(next(line.split()[1] for line in file if line.startswith("VmHWM:")))
"""


def test_two_views_fit_into_400_megabytes(tmp_path: Path) -> None:
    warm_up()  # compiling the kernels takes memory of its own, once
    arguments = ["reconstruct", str(sample_folder()), "-o", str(tmp_path / "scene.ply"), "--views", "0,1", "-q"]
    found = subprocess.run(
        [sys.executable, "-c", PROGRAM, *arguments], check=True, capture_output=True, text=True, timeout=300
    )
    assert (tmp_path / "scene.ply").is_file()
    assert 1024 * int(found.stdout) < MOST_BYTES


def test_the_service_fits_into_400_megabytes_too(tmp_path: Path) -> None:
    warm_up()
    images = sorted((sample_folder() / "images").iterdir())[:2]
    cameras = (sample_folder() / "cameras.json").read_text()
    with serving(tmp_path / "store", shipped_model(), tmp_path / "log") as (client, process):
        answer = post(client, [path.read_bytes() for path in images], cameras, names=[path.name for path in images])
        assert answer.status_code == 201, answer.text
        scene = {"scene": answer.json()["id"], "view": "0.5"}
        assert client.get("/render", params=scene).headers["content-type"] == "image/png"
        status = Path(f"/proc/{process.pid}/status").read_text()
    assert 1024 * int(status.split("VmHWM:")[1].split()[0]) < MOST_BYTES
