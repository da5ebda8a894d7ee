"""Inputs of unfinished jobs on disk: any process of the store can compute them, even after a crash."""

from __future__ import annotations

import contextlib
import hashlib
import json
import shutil
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..process.disk import full_is_refused, made_again, private_folder
from .work import Work

_DOCUMENT = "work.json"
_REQUEST = "request"
_DIGEST = "sha256"  # of the photographs, one after the other
_END = "end.json"
_TEMPORARY = ".incoming-"
SUBMITTING_S = 3600.0  # far longer than writing the photographs and queueing the job take


def _digest(images: Sequence[bytes]) -> str:
    digest = hashlib.sha256()
    for image in images:
        digest.update(len(image).to_bytes(8, "little") + image)
    return digest.hexdigest()


class Spool:
    """One folder per job under `root`, created atomically. It survives a crash of the process, but is not synced to
    disk, so a power cut may lose it."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._make()

    def _ensure_there(self) -> None:
        """Make the folder again where somebody has deleted it. Raises `ServiceBusy` if that fails."""
        with made_again(self._root):
            self._make()

    def _make(self) -> None:
        private_folder(self._root.parent)  # the store
        private_folder(self._root)

    def put(self, job_id: str, work: Work, request_id: str | None = None) -> None:
        """Write a job's inputs and the id of its request. Raises `StorageFull`, and `ServiceBusy` if the folder
        was deleted and cannot be made again."""
        incoming = self._root / f"{_TEMPORARY}{job_id}"
        with full_is_refused("the photographs"):
            try:
                self._ensure_there()
                incoming.mkdir()
                for index, image in enumerate(work.images):
                    (incoming / str(index)).write_bytes(image)
                (incoming / _DOCUMENT).write_text(json.dumps(work.document()), encoding="utf-8")
                (incoming / _DIGEST).write_text(_digest(work.images), encoding="utf-8")
                (incoming / _REQUEST).write_text(request_id or "", encoding="utf-8")
                incoming.rename(self._root / job_id)
            finally:
                shutil.rmtree(incoming, ignore_errors=True)

    def get(self, job_id: str) -> Work:
        """Read a job's inputs. Raises `FileNotFoundError`; `ValueError`, `KeyError` or `TypeError` for damaged ones."""
        folder = self._root / job_id
        document = json.loads((folder / _DOCUMENT).read_bytes())
        images = [(folder / str(i)).read_bytes() for i in range(len(document["cameras"]))]
        written = folder / _DIGEST
        if written.exists() and written.read_bytes() != _digest(images).encode():  # an earlier release wrote none
            raise ValueError("its photographs are not those that were written")
        return Work.of_document(document, images)

    def request_id(self, job_id: str) -> str | None:
        """Id of the request that submitted a job, None if unknown."""
        try:
            return (self._root / job_id / _REQUEST).read_text(encoding="utf-8") or None
        except (OSError, ValueError):  # an earlier release wrote none
            return None

    def leave_end(self, job_id: str, state: str, problem: Mapping[str, Any] | None) -> None:
        """Replace a job's inputs by its end, which is far smaller, so that on a full disk another process can record it
        if this one ends first."""
        folder = self._root / job_id
        temporary = folder / f"{_TEMPORARY}{_END}"
        with contextlib.suppress(OSError):  # the disk is full, or the folder was dropped
            for file in folder.iterdir():
                if file.name not in (_END, _REQUEST):
                    file.unlink()
            temporary.write_text(json.dumps([state, problem]), encoding="utf-8")
            temporary.rename(folder / _END)

    def left_end(self, job_id: str) -> tuple[str, dict[str, Any] | None] | None:
        """State and problem that `leave_end` wrote; None if there is no such file, or a power cut has damaged it."""
        try:
            state, problem = json.loads((self._root / job_id / _END).read_bytes())
        except (OSError, ValueError):
            return None
        return state, problem

    def drop(self, job_id: str) -> None:
        """Delete the folder of a job, if it exists."""
        shutil.rmtree(self._root / job_id, ignore_errors=True)

    def sweep(self, active: Iterable[str]) -> None:
        """Delete the folders of jobs that are not `active`; not recent ones, whose jobs may be about to be queued."""
        keep, old = set(active), time.time() - SUBMITTING_S
        self._ensure_there()
        for folder in self._root.iterdir():
            with contextlib.suppress(FileNotFoundError):  # deleted by another process
                if folder.name not in keep and folder.stat().st_mtime < old:
                    shutil.rmtree(folder, ignore_errors=True)
