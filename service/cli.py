"""The command `gapmes` with its sub-commands; a refusal is one line on stderr and exit code 1."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from importlib.metadata import version
from typing import Annotated

import typer
from rich.console import Console

from .allocator import give_back_freed
from .commands import convert, demo, doctor, reconstruct, render, serve
from .errors import CameraError, GapmesError, ImageError
from .extra_commands import WithExtraCommands
from .problem_document import of_error


def _show_version(asked: bool) -> None:
    if asked:
        typer.echo(f"gapmes {version('gapmes')}")
        raise typer.Exit


app = typer.Typer(
    name="gapmes",
    cls=WithExtraCommands,
    help="3D Gaussians from two to six posed photographs, on an ordinary CPU.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",  # the other takes [default: all] for a style
)


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="print the version and end")
    ] = False,
) -> None:
    pass


for module in (serve, reconstruct, render, convert, demo, doctor):
    app.command()(getattr(module, module.__name__.rpartition(".")[2]))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command. Exit codes: 0 done, 1 refused (with the reason and its cure), 2 wrong usage, 130 interrupted.

    With `--json` a refusal is also printed to stdout, as {"error": {...}}.
    """
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    give_back_freed()
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    try:
        app(arguments)
    except GapmesError as error:
        console.print(f"error: {_one_line(error)}", markup=False)
        if "--json" in arguments:
            sys.stdout.write(json.dumps({"error": of_error(error)}) + "\n")
        sys.exit(1)
    except OSError as error:
        console.print(f"error: {error}", markup=False)
        sys.exit(1)
    except KeyboardInterrupt:
        sys.exit(130)


def _one_line(error: GapmesError) -> str:
    of_a_view = isinstance(error, CameraError | ImageError) and error.index is not None
    where = f"view {error.index}: " if of_a_view else ""
    return f"{where}{error}".replace("\n", " ")


if __name__ == "__main__":
    main()
