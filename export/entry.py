"""The command `gapmes-export` where the extra that it needs may be missing: then one line, and no traceback."""

from __future__ import annotations

import sys


def main() -> None:
    """Entry point. Exit status 1 without torch and onnx, else that of `cli.main`."""
    try:
        from .cli import main as run
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] == "gapmes":
            raise
        sys.stderr.write(f"refused: gapmes-export needs {error.name}: pip install 'gapmes[export]'\n")
        sys.exit(1)
    run()
