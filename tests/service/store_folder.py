"""Entries of a store's folder beside its own files."""

from __future__ import annotations

from pathlib import Path


def names(root: Path) -> set[str]:
    """Of scenes, and of leftovers, of which there should be none."""
    return {path.name for path in root.iterdir() if not path.name.startswith(("index.sqlite", ".lock", ".writing"))}
