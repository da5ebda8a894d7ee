"""The command `gapmes` with its sub-commands; a refusal is one line on stderr and exit code 1."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import sys
from collections.abc import Sequence
from importlib.metadata import version
from typing import Annotated, Any

import typer

from .commands import convert, demo, doctor, reconstruct, render, serve
from .errors import MORE_MEMORY, CameraError, GapmesError, ImageError
from .extra_commands import WithExtraCommands
from .problem_document import of_error, problem
from .process.allocator import give_back_freed
from .process.ending import ended_in_order
from .process.streams import open_missing, visible, write_to

_CURES = {  # of what is neither lack of room nor of permission
    errno.ENAMETOOLONG: "give it a shorter name",
    errno.EISDIR: "a folder has that name: move it away, or write elsewhere",
    errno.ENOTDIR: "a file has the name of a folder on the way: move it away, or write elsewhere",
}


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
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="print the version and end")
    ] = False,
) -> None:
    if context.invoked_subcommand != "serve":  # which ends in an order of its own
        context.with_resource(ended_in_order())


for module in (serve, reconstruct, render, convert, demo, doctor):
    app.command()(getattr(module, module.__name__.rpartition(".")[2]))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command. Exit codes: 0 done, 1 refused (with the reason and its cure), 2 wrong usage, 130 interrupted.
    SIGTERM and a terminal that closes end it as they end any program, and nothing half written stays.

    With `--json` a refusal, of ours or of the system, is also printed to stdout, as {"error": {...}}.
    """
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    open_missing()
    give_back_freed()
    try:
        app(arguments)
    except GapmesError as error:
        line, document = _one_line(error), of_error(error)
    except OSError as error:
        line, document = _of_system(error)
    except MemoryError as error:
        line, document = _of_memory(error)
    except KeyboardInterrupt:
        sys.exit(130)
    else:
        return
    with contextlib.suppress(OSError):  # stderr or stdout may be what was refused
        write_to(sys.stderr, f"error: {visible(line)}\n")
    with contextlib.suppress(OSError):
        write_to(sys.stdout, json.dumps({"error": document}) + "\n" if "--json" in arguments else "")
    sys.exit(1)


def _one_line(error: GapmesError) -> str:
    of_a_view = isinstance(error, CameraError | ImageError) and error.index is not None
    where = f"view {error.index}: " if of_a_view else ""
    return f"{where}{error}"


def _of_system(error: OSError) -> tuple[str, dict[str, Any]]:
    """What the system refused, such as a file without permission or on a full disk: a line, and a problem document."""
    where = "" if error.filename is None else f"{error.filename}: "
    detail = str(error) if error.strerror is None else f"{where}{error.strerror}"
    if error.filename is None and error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return detail, problem(500, "system_error", detail)
    who = f" as uid {os.getuid()}" if isinstance(error, PermissionError) else ""
    cure = _CURES.get(error.errno or 0, f"is there room, and permission to read and write there{who}?")
    return f"{detail} ({cure})", problem(500, "storage_error", detail, cure=cure)


def _of_memory(error: MemoryError) -> tuple[str, dict[str, Any]]:
    """Memory that the system does not grant: a line, and a problem document."""
    detail = f"the memory does not suffice{': ' if str(error) else ''}{error}"
    return f"{detail} ({MORE_MEMORY})", problem(500, "system_error", detail, cure=MORE_MEMORY)


if __name__ == "__main__":
    main()
