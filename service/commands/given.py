"""Options that override settings; an empty one, such as `--store "$STORE"` without a value, counts as not given."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer


def _path(text: str) -> Path | None:
    return Path(text) if text else None


def path_option(help: str) -> Any:
    """A path option that is None if empty, where `Path` alone would mean the working directory."""
    return typer.Option(parser=_path, metavar="<path>", help=help)


def given(**options: Any) -> dict[str, Any]:
    """The options that are neither None nor empty."""
    return {name: value for name, value in options.items() if value not in (None, "")}
