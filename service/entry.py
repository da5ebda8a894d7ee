"""The command `gapmes` from its first import on, which an interrupt ends as it ends the work: without a traceback."""

from __future__ import annotations

import logging
import sys


def main() -> None:
    """Entry point. Exit code 130 where it is interrupted, else that of `cli.main`. What libraries warn of is not
    for who uses the command; the service has it in its log."""
    logging.captureWarnings(True)
    try:
        from .cli import main as run

        run()
    except KeyboardInterrupt:
        sys.exit(130)
