"""The house rules that a machine can check: dependencies point one way, and every file says what it holds."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
import tomllib
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = ("service", "model", "export")
# what a package may import of the others
ALLOWED = {"service": set(), "model": {"service"}, "export": {"service", "model"}}
# libraries that must stay out of a package
FORBIDDEN = {
    "service": {"torch", "transformers", "onnx", "plyfile"},
    "model": {"transformers", "fastapi", "onnx", "onnxruntime"},
    "export": {"transformers"},  # tests compare with it; its import takes longer than torch's
}
LONGEST = 300

FILES = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]


def imported(path: Path) -> set[str]:
    """Absolute module names that a file imports, relative ones left out: they stay within the package."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        if isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names.add(node.module)
    return names


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_a_file_keeps_to_the_house_rules(path: Path) -> None:
    package = path.relative_to(ROOT).parts[0]
    names = imported(path)
    others = {name.split(".")[1] for name in names if name.startswith("gapmes.")}
    assert others <= ALLOWED[package]
    assert not {name.split(".")[0] for name in names} & FORBIDDEN.get(package, set())
    assert not {name.split(".")[0] for name in names} & set(PACKAGES), "import by gapmes.*, never by folder name"
    assert ast.get_docstring(ast.parse(path.read_text())), "a file opens with one sentence that says what it holds"
    assert len(path.read_text().splitlines()) <= LONGEST


def test_every_file_of_tests_has_a_name_of_its_own() -> None:
    """They are imported by name alone."""
    names = [path.name for path in (ROOT / "tests").rglob("*.py") if path.name not in ("conftest.py", "__init__.py")]
    assert len(names) > 200
    assert sorted(names) == sorted(set(names))


def folder_of(dotted: str) -> str:
    """The folder of `gapmes.service` that a module lies in; a module that lies in none stands for itself."""
    return dotted.split(".")[2]


def test_the_folders_of_the_service_depend_on_one_another_one_way() -> None:
    """Imports within functions count, those for type checkers alone do not."""
    service = ROOT / "service"
    needs: dict[str, set[str]] = {}
    for path in sorted(service.rglob("*.py")):
        name = ("gapmes", "service", *path.relative_to(service).with_suffix("").parts)
        if len(name) == 3 and name[2] == "__init__":
            continue  # the public names, which lie everywhere
        needs.setdefault(folder_of(".".join(name)), set()).update(
            folder
            for module in relative_imports(path, name[:-1])
            if (folder := folder_of(module)) != folder_of(".".join(name))
        )
    assert len(needs) > 30
    assert list(TopologicalSorter(needs).static_order())  # CycleError names the folders of a cycle


def relative_imports(path: Path, package: tuple[str, ...]) -> set[str]:
    """Dotted names of what a file of `package` imports of the same distribution, at run time."""
    tree = ast.parse(path.read_text())
    for_checkers = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        for inner in ast.walk(node)
    }
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level and id(node) not in for_checkers:
            base = (*package[: len(package) + 1 - node.level], *(node.module or "").split("."))
            found = [part for part in base if part]
            names |= {".".join((*found, alias.name)) for alias in node.names}
    return names


def test_importing_the_app_or_the_public_names_loads_nothing_heavy() -> None:
    code = (
        "import sys, gapmes.service, gapmes.service.app\n"
        "heavy = {'torch', 'transformers', 'onnx', 'onnxruntime', 'numba'} & set(sys.modules)\n"
        "sys.exit(f'loaded: {sorted(heavy)}' if heavy else 0)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr


@pytest.mark.parametrize(
    "first", ["gapmes.export", "gapmes.service.network.backends.choice as c; c.made_by('onnxruntime')"]
)
def test_whoever_imports_onnxruntime_first_its_telemetry_is_off(first: str, tmp_path: Path) -> None:
    stand_in = "import os\n__version__ = '1'\nsaid = os.environ.get('ORT_DISABLE_TELEMETRY')"
    (tmp_path / "onnxruntime.py").write_text(stand_in)
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import {first}\n"
    code += "import onnxruntime; print(onnxruntime.said)"
    environment = {name: value for name, value in os.environ.items() if name != "ORT_DISABLE_TELEMETRY"}
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    assert result.stdout == "1\n"


def test_every_package_folder_is_listed_for_the_wheel() -> None:
    text = (ROOT / "pyproject.toml").read_text()
    for package in PACKAGES:
        for init in (ROOT / package).rglob("__init__.py"):
            folder = init.parent.relative_to(ROOT)
            assert f'"gapmes.{".".join(folder.parts)}"' in text, folder


def test_every_file_beside_the_code_is_listed_for_the_wheel() -> None:
    """An editable install finds files that a wheel would lack."""
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]
    files = [path.relative_to(ROOT) for package in PACKAGES for path in (ROOT / package).rglob("*") if path.is_file()]
    made = ("__pycache__", "tiny.report.json")  # by running the code; by the export, for readers of the repository
    data = [path for path in files if path.suffix != ".py" and not set(made) & set(path.parts)]
    assert len(data) > 20
    for path in data:
        package, *rest = path.parts
        patterns = listed[f"gapmes.{package}"]
        assert any(Path(*rest).match(pattern) and pattern.count("/") == len(rest) - 1 for pattern in patterns), path


def test_the_runtime_asks_for_no_torch_and_the_export_extra_does() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    heavy = ("torch", "transformers", "onnx>", "onnxscript", "plyfile")
    assert not [name for name in project["dependencies"] if name.startswith(heavy)]
    export = project["optional-dependencies"]["export"]
    assert any(name.startswith("torch==") for name in export)
    assert any(name.startswith("onnx>") for name in export)


@pytest.mark.parametrize("module", ["model.training.ahead", "model.training.choice", "export.model_file"])
def test_what_needs_no_network_imports_none(module: str) -> None:
    """Which takes seconds in each process that draws scenes or writes a file."""
    code = f"import sys, gapmes.{module}; sys.exit('gapmes.model.network' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
