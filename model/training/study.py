"""What the commands that study the parts of the network share: options, threads, LPIPS, and the page that they fill."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numba
import torch

from gapmes.service.process.disk import replace_file

from . import arguments as kinds
from .ablation_table import with_tables
from .lpips import Lpips, default_weights


def parse(parser: argparse.ArgumentParser, arguments: Sequence[str] | None) -> argparse.Namespace:
    """Add `--threads`, `--lpips` and `--page` to the parser's options, parse, and set the threads."""
    parser.add_argument(
        "--threads", type=kinds.threads(), default=1, help="one thread per process is fastest on shared cores"
    )
    parser.add_argument(
        "--lpips", type=Path, metavar="FILE", help="weights for LPIPS; default: those in shared/weights, if there are"
    )
    parser.add_argument("--page", type=Path, help="a Markdown page whose tables, between its markers, are replaced")
    options = parser.parse_args(arguments)
    torch.set_num_threads(options.threads)
    numba.set_num_threads(options.threads)
    return options


def asked_lpips(options: argparse.Namespace) -> Lpips | None:
    """LPIPS with the given weights or the default ones; None if there are neither. Raises `InputError` for a file that
    holds others."""
    path = options.lpips or default_weights()
    return Lpips.load(path) if path else None


def fill_page(page: Path, text: str, marker: str) -> None:
    """Put `text` between the markers of a page; raises `ValueError` for a page without them, and `OSError`."""
    replace_file(page, with_tables(page.read_text(encoding="utf-8"), text, marker).encode())


def check_page(page: Path, marker: str) -> None:
    """Raise what `fill_page` would raise for its markers, before the work and not after it."""
    with_tables(page.read_text(encoding="utf-8"), "", marker)
