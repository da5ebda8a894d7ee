"""Expansion of ~ in paths that no shell has expanded, such as those in a file of settings."""

from __future__ import annotations

from pathlib import Path


def at_home(path: Path) -> Path:
    """`path` with a leading ~ replaced by the home folder. Raises `ValueError` if that is unknown."""
    if path.parts[:1] != ("~",):
        return path
    try:
        return path.expanduser()
    except RuntimeError as error:
        raise ValueError(f"{path} begins with ~, and HOME is not set") from error
