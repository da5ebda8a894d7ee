"""The ~ of a path that no shell has read, such as one in a file of settings."""

from __future__ import annotations

from pathlib import Path


def at_home(path: Path) -> Path:
    """`path` with the user's own folder for a leading ~. Raises `ValueError` where nobody knows that folder."""
    if path.parts[:1] != ("~",):
        return path
    try:
        return path.expanduser()
    except RuntimeError as error:
        raise ValueError(f"{path} begins with ~, and HOME is not set") from error
