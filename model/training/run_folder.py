"""The folder of a run: its state, written atomically, its log of JSON lines, its weights, and a lock."""

from __future__ import annotations

import fcntl
import json
import os
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from gapmes.service.process.disk import replace_file

from ..allocation import lacks_memory
from ..checkpoint import WEIGHTS, save_checkpoint
from .differences import differences
from .log_rows import read_rows

if TYPE_CHECKING:
    from ..network import GaPMeS

STATE = "state.pt"
LOG = "log.jsonl"
LOCK = "lock"

REVISION = "6"  # to raise when the state or the derivation of random numbers changes: older runs are then refused
CURES = {  # of what no option sets, where a run is of another one
    "precision": "the device decides it, so go on on one like that of the beginning",
    "revision": "go on with the version of gapmes that it began with",
}


class Refused(ValueError):
    """A run that cannot be started or continued in this folder."""


@contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """Lock the folder, which is made if missing; the lock ends with the process.

    Raises `Refused` while another process holds it, and where there can be no such folder.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / LOCK).open("w")
    except OSError as error:
        raise Refused(f"{folder} cannot be the folder of a run: {error.strerror}; name another one") from error
    with lock as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise Refused(f"{folder}: another run is at work there; wait for it or use a new folder") from None
        yield


def save_state(
    folder: Path, progress: dict[str, object], model: GaPMeS, average: GaPMeS, optimiser: torch.optim.Optimizer
) -> None:
    """Save atomically what resuming needs, and the averaged weights so far. Frozen parts are left out of the state: a
    resumed run loads them as a new one does. Raises `OSError`."""
    trained = trained_names(model)
    state = {
        **progress,
        "model": {name: value for name, value in model.state_dict().items() if name in trained},
        "average": {name: value for name, value in average.state_dict().items() if name in trained},
        "optimiser": optimiser.state_dict(),
    }
    part = folder / (STATE + ".part")
    try:
        with part.open("wb") as file:
            torch.save(state, file)
            file.flush()
            os.fsync(file.fileno())  # before the rename: after a power failure one of the two states is there, whole
        os.replace(part, folder / STATE)
    except (OSError, RuntimeError) as error:
        part.unlink(missing_ok=True)
        # torch's writer raises another error in place of the system's
        cause = error if isinstance(error, OSError) else error.__context__
        if isinstance(cause, OSError):
            raise OSError(cause.errno, cause.strerror, str(part)) from error
        raise
    save_weights(folder, average, progress["step"])


def trained_names(model: GaPMeS) -> set[str]:
    return {name for name, parameter in model.named_parameters() if parameter.requires_grad}


def save_weights(folder: Path, average: GaPMeS, step: object) -> None:
    save_checkpoint(folder / WEIGHTS, average, extra={"gapmes.step": str(step)})


def read_state(path: Path, *, mmap: bool = False) -> dict[str, Any]:
    """What `save_state` wrote. Raises `Refused` for another file and for a damaged one; with `mmap`, which leaves the
    tensors in the file until they are used, damage in these is not noticed."""
    try:
        state = torch.load(path, weights_only=True, map_location="cpu", mmap=mmap)
        if not mmap:
            _check_sums(path)
    except Exception as error:  # a damaged file makes the restricted reader fail in any of a dozen ways
        raise _damaged(path, error) from error
    if not isinstance(state, dict):
        raise _damaged(path, TypeError(f"it holds a {type(state).__name__}"))
    return state


def _check_sums(path: Path) -> None:
    """Compare the CRC-32 of each part of a file of `torch.save`, a zip archive, which `torch.load` leaves unread."""
    with zipfile.ZipFile(path) as archive:
        if part := archive.testzip():
            raise ValueError(f"{part} has another checksum than when it was written")


def _damaged(path: Path, error: Exception) -> Refused:
    reason = next(iter(str(error).splitlines()), "")[:200]
    if lacks_memory(error):
        return Refused(f"not enough memory to read {path} ({type(error).__name__}: {reason}); free some, and go on")
    return Refused(
        f"{path} cannot be read as the state of a run ({type(error).__name__}: {reason}); it is damaged or of another "
        f"version: use a new folder; what may be of use yet is {WEIGHTS} beside it"
    )


def restore_state(
    folder: Path, identity: dict[str, str | None], model: GaPMeS, average: GaPMeS, optimiser: torch.optim.Optimizer
) -> tuple[int, float, dict[str, float]]:
    """Load the state of the folder, if there is one, into the networks and the optimiser; returns its step, its
    seconds, and the sums since the last row of the log.

    Raises `Refused` if the folder holds another run or weights without a state, and for a damaged state.
    """
    path = folder / STATE
    if not path.is_file():
        if (folder / WEIGHTS).exists():
            raise Refused(
                f"{folder} holds {WEIGHTS} but no {STATE} to go on from: a run would begin anew and replace them; move "
                "them or use a new folder"
            )
        return 0, 0.0, {}
    state = read_state(path)
    for key, value in identity.items():
        if state.get(key) != value:
            raise Refused(
                f"{path} is of a run with another {key}: {differences(_document(state.get(key)), _document(value))}; "
                f"{CURES.get(key, 'go on with what it began with')}, or use a new folder"
            )
    try:
        _load_trained(model, state["model"], trained_names(model))
        _load_trained(average, state["average"], trained_names(model))
        optimiser.load_state_dict(state["optimiser"])
        return int(state["step"]), float(state["seconds"]), dict(state["sums"])
    except (AttributeError, KeyError, RuntimeError, TypeError, ValueError) as error:
        raise _damaged(path, error) from error


def _document(text: Any) -> Any:
    """A part of the identity, parsed if it is a JSON object."""
    return json.loads(text) if isinstance(text, str) and text.startswith("{") else text


def _load_trained(network: GaPMeS, values: dict[str, Tensor], trained: set[str]) -> None:
    if values.keys() != trained:
        raise ValueError(f"it has other tensors than this network trains: {sorted(values.keys() ^ trained)[:5]}")
    network.load_state_dict(values, strict=False)


def append_row(folder: Path, row: dict[str, object]) -> None:
    with (folder / LOG).open("a") as file:
        file.write(json.dumps(row) + "\n")


def forget_rows_after(folder: Path, step: int) -> None:
    """Drop log rows after `step`, which will be repeated since no later state was saved, and an incomplete last row.

    Raises `Refused` that names a line which is no row.
    """
    path = folder / LOG
    if path.is_file():
        try:
            rows = read_rows(path)
        except ValueError as error:
            raise Refused(f"{error}; mend or remove the line, or use a new folder") from error
        replace_file(path, "".join(json.dumps(row) + "\n" for row in rows if row["step"] <= step).encode())
