"""Argument types of the training commands: values out of range are usage errors, reported before any work."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from pathlib import Path

import numba
import torch

LARGEST_SEED = 2**63 - 1  # torch and numpy both take it


def whole_number(least: int, most: int | None = None, limit: str = "") -> Callable[[str], int]:
    """A type for argparse; `limit` says, for the message, what limits `most`."""

    def number(text: str) -> int:
        value = int(text)
        if value < least:
            raise argparse.ArgumentTypeError(f"is {value}, need at least {least}")
        if most is not None and value > most:
            raise argparse.ArgumentTypeError(f"is {value}, need at most {most}{limit and f': {limit}'}")
        return value

    number.__name__ = "whole number"  # argparse's name of it, for text that is no number
    return number


def threads() -> Callable[[str], int]:
    """A type for argparse: at most the number that numba started with, which it cannot exceed later."""
    most: int = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
    set_to = os.environ.get("NUMBA_NUM_THREADS")
    return whole_number(1, most, f"NUMBA_NUM_THREADS is {set_to}" if set_to else "numba has no more on this machine")


def seed() -> Callable[[str], int]:
    """A type for argparse."""
    return whole_number(0, LARGEST_SEED)


def folder(text: str) -> Path:
    """A type for argparse: an empty name, as of a shell variable without a value, would mean the working directory."""
    if not text:
        raise argparse.ArgumentTypeError("is empty, need the name of a folder; the working directory is .")
    return Path(text)


def device(text: str) -> str:
    """A type for argparse: the name that torch has for the processor, or for a graphics card that it can use; `auto`
    takes a card if there is one."""
    cards = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if text == "auto":
        return "cuda" if cards else "cpu"
    kind, colon, index = text.partition(":")
    if kind not in ("cpu", "cuda") or (colon and not (index.isascii() and index.isdecimal())):
        raise argparse.ArgumentTypeError(f"is {text!r}, need cpu, cuda, cuda:NUMBER or auto")
    if kind == "cpu":
        return kind
    number = int(index or 0)
    if number >= cards:
        raise argparse.ArgumentTypeError(f"is {text!r}, but torch finds {cards} graphics cards here: give cpu or auto")
    return f"{kind}:{number}" if index else kind
