"""Options that are settings, too: one that is empty, as `--store "$STORE"` may be, is not given, like a variable."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer


def _path(text: str) -> Path | None:
    return Path(text) if text else None


def path_option(help: str) -> Any:
    """An option that names a file or a folder: of an empty one `Path` would make the working directory."""
    return typer.Option(parser=_path, metavar="<path>", help=help)


def given(**options: Any) -> dict[str, Any]:
    """Those that say something."""
    return {name: value for name, value in options.items() if value not in (None, "")}
