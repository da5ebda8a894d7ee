"""The build: brings the page's WebGL viewer by npm where there is npm, and goes on without it where there is none.

`GAPMES_VIEWER=require` makes its absence an error, as a release needs it; `GAPMES_VIEWER=skip` does not ask npm at all.
The page has its pictures from the service where the viewer is missing.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

ROOT = Path(__file__).resolve().parent
LOCKED = ROOT / "service" / "viewer"
TARGET = ROOT / "service" / "static" / "viewer"
PACKAGE = "node_modules/@playcanvas/supersplat-viewer"
FILES = ("public/index.js", "public/index.css", "LICENSE")
SECONDS = 180


def bring_viewer() -> None:
    """Put the locked viewer into the page's folder unless it is there; `SystemExit` where it must be and cannot."""
    wish = os.environ.get("GAPMES_VIEWER", "")
    locked = json.loads((LOCKED / "package-lock.json").read_text())["packages"][PACKAGE]
    mark = TARGET / "integrity.txt"
    if wish == "skip" or (mark.is_file() and mark.read_text() == locked["integrity"]):
        return
    try:
        _install(mark, locked["integrity"])
    except (OSError, subprocess.SubprocessError) as error:
        reason = str(getattr(error, "stderr", None) or error).strip()[-500:]
        if wish == "require":
            raise SystemExit(f"the WebGL viewer is missing, and GAPMES_VIEWER=require: {reason}") from error
        sys.stderr.write(f"without the WebGL viewer the page has its pictures from the service: {reason}\n")


def _install(mark: Path, integrity: str) -> None:
    npm = shutil.which("npm")
    if npm is None:
        raise FileNotFoundError("there is no npm")
    with tempfile.TemporaryDirectory() as folder:
        for name in ("package.json", "package-lock.json"):
            shutil.copy(LOCKED / name, folder)
        command = [npm, "ci", "--ignore-scripts", "--no-audit", "--no-fund", "--fetch-retries=1", "--prefix", folder]
        subprocess.run(command, check=True, capture_output=True, text=True, timeout=SECONDS, cwd=folder)
        shutil.rmtree(TARGET, ignore_errors=True)
        TARGET.mkdir(parents=True)
        for name in FILES:
            shutil.copy(Path(folder, PACKAGE, name), TARGET)
        mark.write_text(integrity)


class WithViewer(build_py):
    """The packages, and beside the page's files those of the viewer."""

    def run(self) -> None:
        bring_viewer()
        super().run()


if __name__ == "__main__":
    setup(cmdclass={"build_py": WithViewer})
