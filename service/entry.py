"""The command `gapmes` from its first import on, which an interrupt ends as it ends the work: without a traceback."""

from __future__ import annotations

import sys


def main() -> None:
    """Entry point. Exit code 130 where it is interrupted, else that of `cli.main`."""
    try:
        from .cli import main as run

        run()
    except KeyboardInterrupt:
        sys.exit(130)
