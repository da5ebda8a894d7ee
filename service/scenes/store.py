"""The scene store: content-addressed folders, an index over them, eviction by size and age, a cache in memory."""

from __future__ import annotations

import json
import logging
import os
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import Any

from ..errors import FormatError, GapmesError, SceneNotFound, StorageFull
from ..formats.dialect import STANDARD
from ..formats.ply import inspect_ply
from ..gaussians import Gaussians
from ..process.disk import private_folder
from ..process.file_lock import exclusive, exclusive_if_free, shared
from . import scene_ids
from .database import Database
from .gaussians_cache import GaussiansCache
from .own_files import check_own_files
from .scene_files import SceneFiles, unknown
from .scene_index import Indexed, SceneIndex

CACHE_BYTES = 512 * 2**20
PAGE = 100
DAY_NS = 86_400 * 10**9
LATEST_NS = 2**62  # in the year 2116; a file's time beyond it is ignored
_LOCK = ".lock"
_WRITING = ".writing"
_INDEX = "index.sqlite"
_log = logging.getLogger("gapmes")


class SceneStore:
    """One folder per scene under `root`; safe for several threads, and for several processes on one file system."""

    scene_id = staticmethod(scene_ids.scene_id)

    def __init__(
        self,
        root: str | Path,
        *,
        cache_bytes: int = CACHE_BYTES,
        max_bytes: int | None = None,
        max_days: float | None = None,
    ) -> None:
        """Create `root` if needed, synchronise its index, and delete leftovers of a crash if no other process writes.

        Above `max_bytes` the least recently read scenes are evicted; `evict_old` also evicts those that nobody has read
        for `max_days`. Raises `GapmesError` if the folder cannot be created or written, or its index belongs to a later
        version.
        """
        self.root = Path(root)
        self.max_bytes, self.max_days = max_bytes, max_days
        self._files = SceneFiles(self.root)
        self._cache = GaussiansCache(cache_bytes)
        try:
            private_folder(self.root)
            self.database = Database(self.root / _INDEX, self._fill)
            check_own_files(self.root)
            self._index = SceneIndex(self.database)
            with exclusive_if_free(self.root / _LOCK) as free:
                if free:
                    self._files.sweep()
                    self._agree()
            self._index.used_by_now()
        except OSError as error:
            inside = error.filename is not None and Path(error.filename).is_relative_to(self.root)
            raise GapmesError(
                f"{error.filename if inside else self.root} cannot be used: {error.strerror}",
                field="store",
                cure=f"let GAPMES_STORE or --store name a folder that this user (uid {os.getuid()}) may write, and all"
                " that the service keeps in it",
            ) from error

    def put(self, scene_id: str, ply: bytes, document: Mapping[str, Any], inputs: Sequence[bytes] = ()) -> bool:
        """Store a scene with PNGs of its inputs, atomically; returns False where it exists, and is kept. A damaged one
        is replaced.

        Raises `StorageFull` if the disk is full, or if `max_bytes` is reached and all other scenes are being read.
        """
        with self._alone():
            new = not self._files.whole(scene_id)
            if new:
                text = json.dumps(document, allow_nan=False).encode()
                self._make_room(len(ply) + len(text) + sum(map(len, inputs)))
                self._files.write(scene_id, ply, text, self._index.next_ns(), inputs)
                self._cache.drop(scene_id)
            try:
                if new:  # the row of a damaged one
                    self._index.remove([scene_id])
                self._list([scene_id])
            except BaseException:
                if new:
                    self._files.remove(scene_id)
                raise
        return new

    def listed(self, scene_id: str) -> bool:
        """Whether the scene exists undamaged; if it does, it is added to the index if a crash has prevented that."""
        if self.exists(scene_id):
            with self._alone():
                self._list([scene_id])
        return self.exists(scene_id)

    def exists(self, scene_id: str) -> bool:
        """Whether the scene exists undamaged. False for a malformed id."""
        return self._files.whole(scene_id)

    def document(self, scene_id: str) -> dict[str, Any]:
        """The scene's document. Raises `SceneNotFound`, and `FormatError` for a damaged scene."""
        self._index.used(scene_id)
        return self._files.document(scene_id)

    def input(self, scene_id: str, index: int) -> bytes:
        """A photograph as the scene has it, as PNG. Raises `SceneNotFound`, also for an input that does not exist."""
        self._index.used(scene_id)
        return self._files.input(scene_id, index)

    def reading(self, scene_id: str) -> AbstractContextManager[Path]:
        """The path of the scene's .ply, which is not evicted during the block. Raises `SceneNotFound`, and
        `FormatError` if it is empty."""
        self._index.used(scene_id)
        return self._files.reading(scene_id)

    def keeping(self, scene_id: str) -> AbstractContextManager[None]:
        """The scene is not evicted during the block. Raises as `reading`, on entry only."""
        self._index.used(scene_id)
        return self._files.keeping(scene_id)

    def ply(self, scene_id: str) -> bytes:
        """The bytes of the .ply. Raises as `reading`."""
        with self.reading(scene_id) as path:
            return path.read_bytes()

    def gaussians(self, scene_id: str) -> Gaussians:
        """The scene's Gaussians, cached in memory until its file is another. Raises as `reading`."""
        with self.reading(scene_id) as path:
            file = path.stat()  # another process may have replaced a damaged one
            version = file.st_ino, file.st_mtime_ns
            return self._cache.get(scene_id, version, lambda: inspect_ply(path, dialect=STANDARD).gaussians)

    def page(self, limit: int, after: tuple[int, str] | None = None) -> Sequence[Indexed]:
        """Up to `limit` scenes that follow `after` (created_ns, id), newest first, then by id."""
        return self._index.page(limit, after)

    def totals(self) -> tuple[int, int]:
        """Number of scenes, and their size in bytes."""
        return self._index.totals()

    def newest(self) -> str:
        """Id of the scene that was stored last. Raises `SceneNotFound` if the store is empty."""
        for row in self._index.page(PAGE):
            if self.exists(row.id):  # it may be damaged, or deleted before a crash
                return row.id
        raise SceneNotFound(
            "the store holds no scene", field="scene", cure="POST /reconstruct makes one, POST /scenes loads one"
        )

    def writable(self) -> bool:
        """Whether a file can be written, and rows inserted into the index. Raises `ServiceBusy` if that is locked, or
        was deleted and cannot be made again."""
        self.database.ensure_there()
        return self._files.writable() and self.database.writable()

    def delete(self, scene_id: str) -> None:
        """Delete a scene, even one that is damaged or of which only the index row is left. Raises `SceneNotFound`."""
        folder = self._files.folder(scene_id)
        with self._alone():
            there = os.path.lexists(folder)
            if there:
                self._files.remove(scene_id)
            if not self._index.remove([scene_id]) and not there:
                raise unknown(scene_id)
        self._cache.drop(scene_id)

    def evict_old(self) -> int:
        """Evict scenes that nobody has read for `max_days`, and those above `max_bytes`, but none that is being read;
        returns how many. Last uses in the future are corrected first."""
        self._index.used_by_now()
        if self.max_days is None and self.max_bytes is None:
            return 0
        with self._alone():
            before, _ = self.totals()
            if self.max_days is not None:
                old = max(0, time.time_ns() - int(self.max_days * DAY_NS))
                for row in self._index.longest_unused(old):
                    self._evict(row)
            with suppress(StorageFull):
                self._make_room(0)
            return before - self.totals()[0]

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """Only one thread of all processes changes folders and index at a time."""
        self.database.ensure_there()
        with shared(self.root / _LOCK), exclusive(self.root / _WRITING):
            yield

    def _make_room(self, more: int) -> None:
        if self.max_bytes is None:
            return
        cure = "raise GAPMES_STORE_BYTES"
        if more > self.max_bytes:
            message = f"the scene has {more} bytes, more than the store's limit of {self.max_bytes}"
            raise StorageFull(message, field="store", cure=cure)
        if self.totals()[1] + more <= self.max_bytes:
            return
        awaited = self._index.awaited()
        unused = (row for row in self._index.longest_unused() if row.id not in awaited)
        while (held := self.totals()[1]) + more > self.max_bytes:
            row = next(unused, None)
            if row is None:
                message = f"{held} bytes are being read, {more} more would pass the limit of {self.max_bytes}"
                raise StorageFull(message, field="store", cure=f"{cure}, or try again when fewer are being read")
            self._evict(row)

    def _evict(self, row: Indexed) -> None:
        """Delete a scene and its row, unless somebody reads it."""
        try:
            if not self._files.remove(row.id, unless_read=True):
                return
        except SceneNotFound:  # deleted meanwhile
            pass
        self._index.remove([row.id])
        self._cache.drop(row.id)

    def _fill(self, database: Database) -> None:
        self._index = SceneIndex(database)
        self._agree()

    def _agree(self) -> None:
        """Make the index agree with the folders."""
        there, listed = self._files.ids(), self._index.ids()
        self._index.remove(listed - there)
        self._list(there - listed)

    def _list(self, ids: Iterable[str]) -> None:
        """Add folders to the index; one that cannot be read, as after a power cut, is skipped and logged."""
        rows = []
        for scene_id in ids:
            try:
                document = self._files.document(scene_id)
                size, created_ns = self._files.size(scene_id)
            except (SceneNotFound, FormatError, OSError) as error:
                _log.warning("scene %s cannot be read and is not listed: %s", scene_id, error)
                continue
            now = time.time_ns()
            made = created_ns if created_ns < LATEST_NS else now
            rows.append(Indexed(scene_id, made, now, size, _summary(scene_id, document)))
        self._index.add(rows)


def _summary(scene_id: str, document: Mapping[str, Any]) -> dict[str, Any]:
    file = document.get("file")
    return {
        "id": scene_id,
        "created": document.get("created"),
        "gaussians": document["gaussians"].get("count"),
        "views": len(document["view_cameras"]),
        "file": file.get("format") if isinstance(file, Mapping) else None,
    }
