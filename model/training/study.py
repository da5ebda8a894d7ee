"""What the commands that study the parts of the network share: options, threads, LPIPS, their page, exit statuses."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

import numba
import torch
from rich.console import Console

from gapmes.service.errors import InputError
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


def carry_out(
    study: Callable[[], str],
    show: Callable[[str], object],
    *,
    page: Path | None,
    marker: str,
    console: Console,
    stopped: str,
) -> int:
    """Do the study, put the text that it returns between the markers of the page, if one is given, and show it.

    Returns the exit status: 0 done; 1 refused, with the reason on the console; 130 interrupted, which `stopped` words.
    """
    try:
        if page:
            check_page(page, marker)
        text = study()
        if page:
            fill_page(page, text, marker)
    except (ValueError, OSError, InputError) as error:
        console.print(f"refused: {error}", markup=False)
        return 1
    except KeyboardInterrupt:
        console.print(f"stopped; {stopped}", markup=False)
        return 130
    show(text)
    return 0


def fill_page(page: Path, text: str, marker: str) -> None:
    """Put `text` between the markers of a page; raises `ValueError` for a page without them, and `OSError`."""
    replace_file(page, with_tables(page.read_text(encoding="utf-8"), text, marker).encode())


def check_page(page: Path, marker: str) -> None:
    """Raise what `fill_page` would raise for its markers, before the work and not after it."""
    with_tables(page.read_text(encoding="utf-8"), "", marker)
