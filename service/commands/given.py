"""Options of several commands: those that override settings, where an empty one, such as `--store "$STORE"` without a
value, counts as not given; paths of outputs, where an empty one is refused; the number of threads."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ..process.threads import MAX_THREADS

Threads = Annotated[int | None, typer.Option(min=1, max=MAX_THREADS, help="CPU threads [default: all]")]


def _path(text: str) -> Path | None:
    return Path(text) if text else None


def path_option(help: str) -> Any:
    """A path option that is None if empty, where `Path` alone would mean the working directory."""
    return typer.Option(parser=_path, metavar="<path>", help=help)


def output_path(text: str) -> Path:
    """A path to write to. Raises `BadParameter` for an empty one, which would mean the working directory, and for `-`,
    which would be the name of a file."""
    if text == "":
        raise typer.BadParameter("is empty; name a file or a folder")
    if text == "-":
        raise typer.BadParameter(
            "- does not stand for stdout here; gapmes convert writes to /dev/stdout, if --to names the format, and a"
            " file of that name is ./-"
        )
    return Path(text)


def output_option(help: str, *names: str) -> Any:
    """An option for the path of an output, see `output_path`."""
    return typer.Option(*names, parser=output_path, metavar="<path>", help=help)


def given(**options: Any) -> dict[str, Any]:
    """The options that are neither None nor empty."""
    return {name: value for name, value in options.items() if value not in (None, "")}
