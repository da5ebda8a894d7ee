"""The folder of a run: its state, whole or not at all, its log of JSON lines, its weights, and who works in it."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch
from torch import Tensor

from ..checkpoint import save_checkpoint
from ..network import GaPMeS
from .log_rows import read_rows

STATE = "state.pt"
WEIGHTS = "weights.safetensors"
LOG = "log.jsonl"
LOCK = "lock"


REVISION = "3"  # of what a state holds and of where random numbers come from: another one is another run


class Refused(ValueError):
    """A run that cannot be begun or gone on with in this folder."""


@contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """Hold the folder alone; raises `Refused` while another process does. A kill frees it."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / LOCK).open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise Refused(f"{folder}: another run is at work there; wait for it or use a new folder") from None
        yield


def save_state(
    folder: Path, progress: dict[str, object], model: GaPMeS, average: GaPMeS, optimiser: torch.optim.Optimizer
) -> None:
    """Everything that a later start needs but the frozen parts, which it gets as this one did; and the averaged weights
    so far, whole."""
    trained = trained_names(model)
    state = {
        **progress,
        "model": {name: value for name, value in model.state_dict().items() if name in trained},
        "average": {name: value for name, value in average.state_dict().items() if name in trained},
        "optimiser": optimiser.state_dict(),
    }
    part = folder / (STATE + ".part")
    torch.save(state, part)
    os.replace(part, folder / STATE)
    save_weights(folder, average, progress["step"])


def trained_names(model: GaPMeS) -> set[str]:
    return {name for name, parameter in model.named_parameters() if parameter.requires_grad}


def save_weights(folder: Path, average: GaPMeS, step: object) -> None:
    save_checkpoint(folder / WEIGHTS, average, extra={"gapmes.step": str(step)})


def restore_state(
    folder: Path, identity: dict[str, str | None], model: GaPMeS, average: GaPMeS, optimiser: torch.optim.Optimizer
) -> tuple[int, float, dict[str, float]]:
    """Step, seconds and sums since the last row of the log to go on from; raises `Refused` when the folder holds a run
    of something else."""
    path = folder / STATE
    if not path.is_file():
        return 0, 0.0, {}
    state = torch.load(path, weights_only=True, map_location="cpu")
    for key, value in identity.items():
        if state.get(key) != value:
            raise Refused(
                f"{path} is of a run with another {key}: {state.get(key)}, asked for {value}; use a new folder"
            )
    _load_trained(model, state["model"], trained_names(model), path)
    _load_trained(average, state["average"], trained_names(model), path)
    optimiser.load_state_dict(state["optimiser"])
    return int(state["step"]), float(state["seconds"]), dict(state["sums"])


def _load_trained(network: GaPMeS, values: dict[str, Tensor], trained: set[str], path: Path) -> None:
    if values.keys() != trained:
        raise ValueError(f"{path} has other tensors than this network trains: {sorted(values.keys() ^ trained)[:5]}")
    network.load_state_dict(values, strict=False)


def append_row(folder: Path, row: dict[str, object]) -> None:
    with (folder / LOG).open("a") as file:
        file.write(json.dumps(row) + "\n")


def forget_rows_after(folder: Path, step: int) -> None:
    """Drop log rows of steps that were lost with a kill and will be done again, and one that was cut short by it.

    Raises `ValueError` that names a line which is no row.
    """
    path = folder / LOG
    if path.is_file():
        part = folder / (LOG + ".part")
        part.write_text("".join(json.dumps(row) + "\n" for row in read_rows(path) if row["step"] <= step))
        os.replace(part, path)
