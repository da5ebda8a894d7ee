"""Progress on stderr: a bar with its time for each stage on a terminal, plain lines elsewhere."""

from __future__ import annotations

import os
from contextlib import ExitStack
from types import TracebackType
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TaskID, TextColumn
from rich.text import Text

from ..progress import Stage
from .ending import done_at_the_end
from .streams import visible

QUIET_HELP = "write only errors to stderr"
Quiet = Annotated[bool, typer.Option("-q", "--quiet", help=QUIET_HELP)]  # of all commands but `serve`

NAME_WIDTH = 14  # the longest stage name, so that all bars begin in one column


class _Seconds(ProgressColumn):
    """The measured seconds of a stage that has ended, else the time since it began."""

    def render(self, task: Task) -> Text:
        measured = task.fields["seconds"]
        return Text(_seconds((task.elapsed or 0.0) if measured is None else measured))


def _seconds(value: float) -> str:
    return f"{value:7.2f} s"


class ProgressBars:
    """A listener for `Stages`, to be used as a context manager. Writes to stderr; stdout is for results.

    `quiet`: writes neither bars nor lines.
    """

    def __init__(self, console: Console | None = None, *, quiet: bool = False) -> None:
        self.console = console or Console(stderr=True, highlight=False, soft_wrap=True, quiet=quiet)
        self._live = self.console.is_terminal and not quiet
        self._progress = Progress(
            TextColumn(f"{{task.description:{NAME_WIDTH}}}"),
            BarColumn(bar_width=30),
            MofNCompleteColumn(),
            _Seconds(),
            console=self.console,
            disable=not self._live,
        )
        self._tasks: dict[str, TaskID] = {}
        self._drawn = ExitStack()

    def __enter__(self) -> ProgressBars:
        if self._live:
            self._drawn.enter_context(done_at_the_end(self._show_cursor))
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()
        self._drawn.close()

    def _show_cursor(self) -> None:
        """Restore the cursor, bypassing the console, whose lock may be held."""
        os.write(self.console.file.fileno(), b"\x1b[?25h\n")

    def __call__(self, event: Stage) -> None:
        """Show one event; a stage that has ended shows its seconds."""
        if not self._live:
            if event.seconds is not None:
                self.console.print(f"{event.name:{NAME_WIDTH}} {_seconds(event.seconds)}")
            return
        if event.name not in self._tasks:
            self._tasks[event.name] = self._progress.add_task(event.name, total=event.total, seconds=event.seconds)
        self._progress.update(self._tasks[event.name], completed=event.done, total=event.total, seconds=event.seconds)

    def say(self, text: str) -> None:
        """Print the text, escaped by `visible`, as one line above the bars."""
        self.console.print(visible(text), markup=False)
