"""The command `gapmes-export`."""

from __future__ import annotations

from gapmes.model.extra import imports_of


def main() -> None:
    """Entry point. Exit status 1 where torch, onnx and the like cannot be imported, else that of `cli.main`."""
    with imports_of("gapmes-export"):
        from .cli import main as run
    run()
