"""The build step that installs the WebGL viewer: when it runs npm, what it keeps, and what happens without npm."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType

import pytest
import setuptools

ROOT = Path(__file__).parent.parent
FILES = {"index.js", "index.css", "LICENSE", "integrity.txt"}

# Does what `npm ci --prefix FOLDER` does for the one package, and notes that it was asked.
NPM = """#!{python}
import json, pathlib, sys
with open({log!r}, "a") as log:
    log.write(" ".join(sys.argv[1:]) + "\\n")
if {fails}:
    sys.exit("npm error network request to https://registry.invalid failed, reason: getaddrinfo ENOTFOUND")
folder = pathlib.Path(sys.argv[sys.argv.index("--prefix") + 1])
package = "node_modules/@playcanvas/supersplat-viewer"
integrity = json.loads((folder / "package-lock.json").read_text())["packages"][package]["integrity"]
assert (folder / "package.json").is_file()
for name in ("public/index.js", "public/index.css", "LICENSE", "public/of-no-use.js"):
    path = folder / package / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(name + " of " + integrity)
"""


class Build:
    """setup.py over a folder of its own, with an `npm` that is not the machine's."""

    def __init__(self, module: ModuleType, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.module, self.target, self._monkeypatch = module, folder / "static" / "viewer", monkeypatch
        self._log, self._bin, self._locked = folder / "npm.log", folder / "bin", folder / "viewer"
        self._bin.mkdir()
        self._locked.mkdir()
        for name, value in (("ROOT", folder), ("LOCKED", self._locked), ("TARGET", self.target)):
            monkeypatch.setattr(module, name, value)
        monkeypatch.setenv("PATH", str(self._bin))
        monkeypatch.delenv("GAPMES_VIEWER", raising=False)
        self.lock("sha512-first")

    def lock(self, integrity: str) -> None:
        """The version that the checkout requires."""
        packages = {self.module.PACKAGE: {"integrity": integrity}}
        (self._locked / "package-lock.json").write_text(json.dumps({"packages": packages}))
        (self._locked / "package.json").write_text("{}")

    def npm(self, *, fails: bool = False) -> None:
        """Puts an npm on the path from now on."""
        path = self._bin / "npm"
        path.write_text(NPM.format(python=sys.executable, log=str(self._log), fails=fails))
        path.chmod(0o755)

    def run(self, wish: str = "") -> None:
        self._monkeypatch.setenv("GAPMES_VIEWER", wish)
        self.module.bring_viewer()

    @property
    def asked(self) -> list[str]:
        """The command lines that npm was run with."""
        return self._log.read_text().splitlines() if self._log.exists() else []

    def files(self) -> dict[str, str]:
        return {path.name: path.read_text() for path in self.target.iterdir()} if self.target.exists() else {}


@pytest.fixture
def build(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Build:
    def never(**_: object) -> None:
        raise AssertionError("importing setup.py builds")

    monkeypatch.setattr(setuptools, "setup", never)
    spec = importlib.util.spec_from_file_location("gapmes_setup", ROOT / "setup.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return Build(module, tmp_path, monkeypatch)


def test_the_files_are_brought_with_their_mark_and_not_twice(build: Build) -> None:
    build.npm()
    build.run()
    files = build.files()
    assert set(files) == FILES
    assert files["integrity.txt"] == "sha512-first"
    assert files["index.js"] == "public/index.js of sha512-first"
    [asked] = build.asked
    assert asked.startswith("ci --ignore-scripts ")
    build.run()
    build.run("require")
    assert len(build.asked) == 1
    assert build.files() == files


def test_another_version_takes_the_place_of_the_one_that_is_there(build: Build) -> None:
    build.npm()
    build.run()
    (build.target / "of-an-older-version.js").write_text("")
    build.lock("sha512-second")
    build.run()
    assert len(build.asked) == 2
    assert set(build.files()) == FILES
    assert build.files()["integrity.txt"] == "sha512-second"
    assert build.files()["index.css"] == "public/index.css of sha512-second"


def test_files_without_a_mark_are_brought_anew(build: Build) -> None:
    """As after an interrupted copy."""
    build.npm()
    build.run()
    (build.target / "integrity.txt").unlink()
    (build.target / "index.js").write_text("half of")
    build.run()
    assert build.files()["index.js"] == "public/index.js of sha512-first"


@pytest.mark.parametrize("installed", [False, True])
def test_without_npm_or_network_it_goes_on_unless_the_viewer_is_required(
    build: Build, installed: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    if installed:
        build.npm(fails=True)
    reason = "ENOTFOUND" if installed else "there is no npm"
    build.run()
    said = capsys.readouterr().err
    assert said.startswith("without the WebGL viewer the page has its pictures from the service: ")
    assert reason in said
    assert build.files() == {}
    with pytest.raises(SystemExit, match=rf"GAPMES_VIEWER=require: .*{reason}"):
        build.run("require")


def test_an_older_viewer_stays_where_no_newer_one_is_to_be_had(build: Build) -> None:
    build.npm()
    build.run()
    before = build.files()
    build.lock("sha512-second")
    build.npm(fails=True)
    build.run()
    assert build.files() == before
    with pytest.raises(SystemExit, match="ENOTFOUND"):
        build.run("require")


def test_npm_is_not_asked_when_it_is_to_be_skipped(build: Build, capsys: pytest.CaptureFixture[str]) -> None:
    build.npm()
    build.run("skip")
    assert (build.asked, build.files(), capsys.readouterr().err) == ([], {}, "")


def test_the_lock_names_the_package_that_is_brought(build: Build) -> None:
    """And one version of it, with the hash that is the mark."""
    locked = json.loads((ROOT / "service/viewer/package-lock.json").read_text())["packages"][build.module.PACKAGE]
    asked = json.loads((ROOT / "service/viewer/package.json").read_text())["dependencies"]
    assert asked == {build.module.PACKAGE.removeprefix("node_modules/"): locked["version"]}
    assert locked["integrity"].startswith("sha512-")
