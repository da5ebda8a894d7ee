"""The command `gapmes-export` where the extra that it needs may be missing or outdated: then one line, no traceback."""

from __future__ import annotations

import sys


def main() -> None:
    """Entry point. Exit status 1 where torch, onnx and the like cannot be imported, else that of `cli.main`."""
    try:
        from .cli import main as run
    except ImportError as error:
        if error.name is None or error.name.partition(".")[0] == "gapmes":
            raise
        if isinstance(error, ModuleNotFoundError):
            told = f"needs {error.name}: pip install 'gapmes[export]'"
        else:  # it is there, and lacks a name
            told = f"cannot use the installed {error.name} ({error}): pip install --upgrade 'gapmes[export]'"
        sys.stderr.write(f"refused: gapmes-export {told}\n")
        sys.exit(1)
    run()
