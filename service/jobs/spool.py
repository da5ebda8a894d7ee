"""The inputs of unfinished jobs on disk, so that any process can compute them, also after a crash."""

from __future__ import annotations

import contextlib
import json
import shutil
import time
from collections.abc import Iterable
from pathlib import Path

from ..process.disk import full_is_refused
from .work import Work

_DOCUMENT = "work.json"
_REQUEST = "request"
_TEMPORARY = ".incoming-"
SUBMITTING_S = 3600.0  # far longer than writing the photographs and queueing the job take


class Spool:
    """One folder per job under `root`, whole or not there. It survives a crash of the process; a power cut only where
    the system had written it by then."""

    def __init__(self, root: Path) -> None:
        root.mkdir(parents=True, exist_ok=True)
        self._root = root

    def put(self, job_id: str, work: Work, request_id: str | None = None) -> None:
        """Write a job's inputs, and the id of the request that brought them. Raises `StorageFull`."""
        incoming = self._root / f"{_TEMPORARY}{job_id}"
        with full_is_refused("the photographs"):
            try:
                incoming.mkdir()
                for index, image in enumerate(work.images):
                    (incoming / str(index)).write_bytes(image)
                (incoming / _DOCUMENT).write_text(json.dumps(work.document()), encoding="utf-8")
                (incoming / _REQUEST).write_text(request_id or "", encoding="utf-8")
                incoming.rename(self._root / job_id)
            finally:
                shutil.rmtree(incoming, ignore_errors=True)

    def get(self, job_id: str) -> Work:
        """Read a job's inputs. Raises `FileNotFoundError` where they are gone."""
        folder = self._root / job_id
        document = json.loads((folder / _DOCUMENT).read_bytes())
        return Work.of_document(document, [(folder / str(i)).read_bytes() for i in range(len(document["cameras"]))])

    def request_id(self, job_id: str) -> str | None:
        """Of the request that brought a job's inputs, where that is known."""
        try:
            return (self._root / job_id / _REQUEST).read_text(encoding="utf-8") or None
        except (OSError, ValueError):  # an earlier release wrote none
            return None

    def drop(self, job_id: str) -> None:
        """Remove what there is of it."""
        shutil.rmtree(self._root / job_id, ignore_errors=True)

    def sweep(self, active: Iterable[str]) -> None:
        """Remove what is of no `active` job, but for what is so young that somebody may be submitting it."""
        keep, old = set(active), time.time() - SUBMITTING_S
        for folder in self._root.iterdir():
            with contextlib.suppress(FileNotFoundError):  # another process was faster
                if folder.name not in keep and folder.stat().st_mtime < old:
                    shutil.rmtree(folder, ignore_errors=True)
