"""`make compare-viewer`: the same .ply from the same camera, drawn by us and by SuperSplat's viewer in Chromium.

Needs Chromium, and the viewer that npm installs with the package. The viewer truncates splats elsewhere, fades them
towards the truncation and sorts by its own rule. The pictures therefore agree only approximately, but wrong colours,
handedness or scales would show at once.
"""

from __future__ import annotations

import argparse
import functools
import http
import http.server
import json
import math
import shutil
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from gapmes.service.cameras.camera import Camera
from gapmes.service.captures.capture import read_camera_file
from gapmes.service.formats.ply import read_ply
from gapmes.service.http.page import STATIC
from gapmes.service.http.viewer import viewer_settings
from gapmes.service.shipped import sample_folder
from gapmes.service.splat import render

from ..options import at_least_one, there

VIEWER = STATIC / "viewer"
NEED_DB = 35.0
PATIENCE = 240  # s, for the first frame, drawn without a GPU
SETTLING_MS = 8_000  # after it: the sorter runs in parallel with drawing


def settings_for(camera: Camera) -> dict[str, object]:
    """The camera in the viewer's terms: only an upright pinhole with a central principal point and square pixels."""
    right = camera.rotation[:, 0]
    centred = abs(camera.cx - camera.width / 2) < 1e-6 and abs(camera.cy - camera.height / 2) < 1e-6
    if not centred or abs(camera.fx / camera.fy - 1) > 1e-6 or abs(right[1]) > 1e-3:
        raise SystemExit("the viewer shows only upright cameras with square pixels and a central principal point")
    return viewer_settings(camera)


PAGE = """<!doctype html>
<link rel="stylesheet" href="index.css">
<style>body { margin: 0; background: #000 } #view { position: relative; width: %dpx; height: %dpx }</style>
<div id="view"></div>
<img src="shown" width="1" height="1" style="position: absolute; right: 0; bottom: 0">
<script type="module">
  import { createViewer } from "./index.js";
  // The picture, and with it the page, finishes loading once the viewer has had time to sort and to draw again.
  window.firstFrame = () => setTimeout(() => fetch("settled"), %d);
  createViewer({
    container: document.getElementById("view"), settings: await (await fetch("settings.json")).json(),
    contentUrl: "./scene.ply", renderer: "webgl", ui: false, noanim: true, nofx: true, exposeGlobals: true,
  });
</script>"""


class Handler(http.server.SimpleHTTPRequestHandler):
    """Serves one folder on the loopback address; holds back the page's last picture until the viewer has drawn."""

    def __init__(self, *args: Any, settled: threading.Event, **options: Any) -> None:
        self.settled = settled
        super().__init__(*args, **options)

    def do_GET(self) -> None:  # the base class names it so
        """Serves a file, or one of the two signals."""
        if self.path == "/settled":
            self.settled.set()
        elif self.path == "/shown":
            self.settled.wait(PATIENCE)
        else:
            return super().do_GET()
        return self.send_error(http.HTTPStatus.NOT_FOUND)

    def log_message(self, format: str, *args: object) -> None:  # the base class names it so
        """Logs nothing."""


def shown_by_viewer(ply: Path, camera: Camera, chromium: str) -> np.ndarray:
    """(H, W, 3) bytes: the viewer's picture of a .ply."""
    settled = threading.Event()
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        for name in ("index.js", "index.css"):
            shutil.copy(VIEWER / name, root / name)
        shutil.copy(ply, root / "scene.ply")
        (root / "settings.json").write_text(json.dumps(settings_for(camera)))
        (root / "page.html").write_text(PAGE % (camera.width, camera.height, SETTLING_MS))
        picture = root / "shown.png"
        handler = functools.partial(Handler, directory=folder, settled=settled)
        with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
            threading.Thread(target=server.serve_forever, daemon=True).start()
            command = [
                chromium, "--headless", "--no-sandbox", "--hide-scrollbars", "--force-device-scale-factor=1",
                "--use-angle=swiftshader", "--enable-unsafe-swiftshader", f"--user-data-dir={root / 'profile'}",
                # larger than the picture: a headless window is never quite as large as it was asked to be
                f"--window-size={camera.width + 200},{camera.height + 200}", f"--screenshot={picture}",
                f"http://127.0.0.1:{server.server_port}/page.html",
            ]  # fmt: skip
            subprocess.run(command, check=True, stderr=subprocess.DEVNULL, timeout=2 * PATIENCE)
            server.shutdown()
        if not settled.is_set():
            raise SystemExit(f"the viewer drew nothing within {PATIENCE} s: has this Chromium WebGL 2?")
        return np.asarray(Image.open(picture).convert("RGB"))[: camera.height, : camera.width]


def main() -> None:
    """Draw with both, print how well they agree, write the pictures side by side; see --help."""
    parser = argparse.ArgumentParser(prog="make compare-viewer", description=__doc__)
    parser.add_argument("--ply", type=there, help="scene to draw (default: the sample scene, reconstructed)")
    parser.add_argument("--cameras", type=there, default=sample_folder() / "cameras.json", help="a camera file")
    parser.add_argument("--view", type=int, default=3, help="index of the camera in the file (3)")
    parser.add_argument("--size", type=at_least_one, default=1024, help="width of the picture, px (1024)")
    parser.add_argument("--chromium", default="chromium", help="the browser's command (chromium)")
    parser.add_argument("--out", type=Path, default=Path("viewer.png"), help="picture to write (viewer.png)")
    options = parser.parse_args()
    if not VIEWER.is_dir():
        raise SystemExit("the viewer is not there: install the package again with npm on the path")
    if shutil.which(options.chromium) is None:
        raise SystemExit(f"{options.chromium} is no command here: install Chromium, or name it with --chromium")
    views = read_camera_file(options.cameras).views
    if not 0 <= options.view < len(views):
        parser.error(f"--view is {options.view}, {options.cameras} has {len(views)} views: need 0 to {len(views) - 1}")
    with tempfile.TemporaryDirectory() as folder:
        ply = options.ply or Path(folder) / "sample.ply"
        if options.ply is None:
            command = [Path(sys.executable).with_name("gapmes"), "reconstruct", sample_folder(), "--views", "1,5"]
            subprocess.run([*command, "--output", ply], check=True)
        camera = views[options.view].camera
        camera = camera.resized(options.size, round(options.size * camera.height / camera.width))
        ours = render(read_ply(ply), camera, outputs=()).rgb8()
        theirs = shown_by_viewer(ply, camera, options.chromium)
    error = ((ours / 255.0 - theirs / 255.0) ** 2).mean()
    db = -10 * math.log10(error + 1e-12)
    amplified = np.clip(127.5 + 8.0 * (ours.astype(float) - theirs), 0, 255).astype(np.uint8)
    Image.fromarray(np.hstack([ours, theirs, amplified])).save(options.out)
    print(
        f"{db:.1f} dB between our picture (left) and the viewer's (middle), difference times 8 (right): {options.out}"
    )
    if db < NEED_DB:
        raise SystemExit(f"need {NEED_DB:g} dB")


if __name__ == "__main__":
    main()
