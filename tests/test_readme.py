"""The README's first screen: its curl lines run against a real service, and its commands exist."""

from __future__ import annotations

import io
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from PIL import Image

from gapmes.service.formats.ply import read_ply
from gapmes.service.local_server import local_server, wait_until_ready
from gapmes.service.photographs.masks import REPLACED
from gapmes.service.progress import Stages
from gapmes.service.settings import Settings
from gapmes.service.shipped import sample_folder

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()
PORT = Settings.model_fields["port"].default


def blocks() -> list[str]:
    return re.findall(r"```\w*\n(.*?)```", README, flags=re.DOTALL)


@pytest.mark.skipif(shutil.which("curl") is None, reason="curl is not installed")
def test_the_curl_lines_yield_a_ply_and_a_picture(tmp_path: Path) -> None:
    import httpx

    (script,) = [block for block in blocks() if "curl" in block]
    assert set(re.findall(r"http://[\d.]+:\d+", script)) == {f"http://127.0.0.1:{PORT}"}  # what `serve` and KEEP=1 take
    folder = tmp_path / "scene"
    shutil.copytree(sample_folder(), folder)
    with local_server(tmp_path / "log", store=tmp_path / "store", keep=False) as (address, process):
        with httpx.Client(base_url=address, timeout=300) as client:
            wait_until_ready(client, process, tmp_path / "log", Stages())
        commands = script.replace(f"http://127.0.0.1:{PORT}", address)
        subprocess.run(["bash", "-ec", commands], cwd=folder, check=True, capture_output=True, env=dict(os.environ))
        with httpx.Client(base_url=address, timeout=300) as client:
            (listed,) = client.get("/scenes").json()["scenes"]
            scene = client.get(f"/scenes/{listed['id']}").json()
    kept = len(read_ply(folder / "scene.ply"))
    # What the network had behind the pixels gives way to what is added, one of either is told and counts for nothing.
    gone = sum(row["count"] for row in scene["dropped"] if row["reason"] != REPLACED)
    assert kept == scene["gaussians"]["count"] > 0.9 * 2 * 256 * 256  # found: 0.99
    assert kept + gone + scene["pruning"]["dropped"] == 2 * 256 * 256 + scene["gaussians"]["added"]
    with Image.open(io.BytesIO((folder / "view.png").read_bytes())) as picture:
        assert picture.size == (256, 256)


def test_every_link_leads_to_a_file() -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", README):
        assert (ROOT / target).is_file(), target


def test_every_make_target_exists() -> None:
    makefile = (ROOT / "Makefile").read_text()
    for target in re.findall(r"^make (\w+)", "\n".join(blocks()), flags=re.MULTILINE):
        assert re.search(rf"^{target}:", makefile, flags=re.MULTILINE), target
