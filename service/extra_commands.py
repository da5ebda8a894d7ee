"""Commands that other packages add to `gapmes` through the entry-point group `gapmes.commands`."""

from __future__ import annotations

from importlib.metadata import entry_points

import typer
from typer.core import TyperGroup

GROUP = "gapmes.commands"


class WithExtraCommands(TyperGroup):
    """Looks at the entry points only for the list of commands and for a name that is not built in.

    Each entry point is a function as `typer.Typer.command` takes it, under the name of its command. Its module must
    import quickly: `gapmes --help` loads all of them.
    """

    def list_commands(self, ctx: typer.Context) -> list[str]:  # type: ignore[override]
        """Built-in commands first."""
        built_in = super().list_commands(ctx)
        return built_in + sorted({entry.name for entry in entry_points(group=GROUP)} - set(built_in))

    def get_command(self, ctx: typer.Context, cmd_name: str):  # type: ignore[override]
        """The command of this name, None where there is none."""
        command = super().get_command(ctx, cmd_name)
        found = () if command is not None else entry_points(group=GROUP, name=cmd_name)
        for entry in found:
            single = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode="markdown")
            single.command(cmd_name)(entry.load())
            return typer.main.get_command(single)
        return command
