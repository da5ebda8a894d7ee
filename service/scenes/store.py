"""The scenes of a service: content-addressed folders, an index over them, limits with eviction, a cache in memory."""

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
from ..process.file_lock import exclusive, exclusive_if_free, shared
from . import scene_ids
from .database import Database
from .gaussians_cache import GaussiansCache
from .scene_files import SceneFiles, is_id, unknown
from .scene_index import Indexed, SceneIndex

CACHE_BYTES = 512 * 2**20
PAGE = 100
DAY_NS = 86_400 * 10**9
LATEST_NS = 2**62  # in the year 2116: what a file says beyond it is not when it was made
_LOCK = ".lock"
_WRITING = ".writing"
_INDEX = "index.sqlite"
_log = logging.getLogger("gapmes")


class SceneStore:
    """One folder per scene under `root`; safe for several threads and for several processes on one file system."""

    scene_id = staticmethod(scene_ids.scene_id)

    def __init__(
        self,
        root: str | Path,
        *,
        cache_bytes: int = CACHE_BYTES,
        max_bytes: int | None = None,
        max_days: float | None = None,
    ) -> None:
        """Make `root` if needed, list what it holds, and remove what a crash left there unless somebody writes.

        Beyond `max_bytes` the scenes go that were read longest ago; those that nobody has read for `max_days` go too,
        when `evict_old` is called.
        Raises `GapmesError` where the folder cannot be made or written, or its index belongs to a later version.
        """
        self.root = Path(root)
        self.max_bytes, self.max_days = max_bytes, max_days
        self._files = SceneFiles(self.root)
        self._cache = GaussiansCache(cache_bytes)
        try:
            self.root.mkdir(parents=True, exist_ok=True)
            self.database = Database(self.root / _INDEX)
            self._index = SceneIndex(self.database)
            with exclusive_if_free(self.root / _LOCK) as free:
                if free:
                    self._files.sweep()
                    self._agree()
            self._index.used_by_now()
        except OSError as error:
            raise GapmesError(
                f"{self.root} cannot be used: {error.strerror}",
                field="store",
                cure=f"let GAPMES_STORE or --store name a folder that this user (uid {os.getuid()}) may write",
            ) from error

    def put(self, scene_id: str, ply: bytes, document: Mapping[str, Any], inputs: Sequence[bytes] = ()) -> None:
        """Store a scene, with PNGs of its inputs: whole or nothing. What is already there stays as it is; what was
        damaged gives way.

        Raises `StorageFull` when the disk is, or when `max_bytes` is reached and all that is there is being read.
        """
        with self._alone():
            new = not self._files.whole(scene_id)
            if new:
                text = json.dumps(document, allow_nan=False).encode()
                self._make_room(len(ply) + len(text) + sum(map(len, inputs)))
                self._files.write(scene_id, ply, text, self._index.next_ns(), inputs)
                self._cache.drop(scene_id)
            try:
                if new:  # what was known of a damaged one
                    self._index.remove([scene_id])
                self._list([scene_id])
            except BaseException:
                if new:
                    self._files.remove(scene_id)
                raise

    def listed(self, scene_id: str) -> bool:
        """Whether the scene is there, whole; then it is in the list too, whatever a crash has left out."""
        if self.exists(scene_id):
            with self._alone():
                self._list([scene_id])
        return self.exists(scene_id)

    def exists(self, scene_id: str) -> bool:
        """Whether the scene is there, whole: one that was damaged counts as none. False for what is no id at all."""
        return is_id(scene_id) and self._files.whole(scene_id)

    def document(self, scene_id: str) -> dict[str, Any]:
        """The scene's document. Raises `SceneNotFound`, and `FormatError` where it was damaged."""
        self._index.used(scene_id)
        return self._files.document(scene_id)

    def input(self, scene_id: str, index: int) -> bytes:
        """A PNG of what the network saw of a photograph. Raises `SceneNotFound`, also where there is none."""
        self._index.used(scene_id)
        return self._files.input(scene_id, index)

    def reading(self, scene_id: str) -> AbstractContextManager[Path]:
        """The scene's .ply file, which is not evicted during the block. Raises `SceneNotFound`, and `FormatError` for
        an empty one."""
        self._index.used(scene_id)
        return self._files.reading(scene_id)

    def keeping(self, scene_id: str) -> AbstractContextManager[None]:
        """The scene is not evicted during the block, in which it is read piece by piece, or later. Raises as
        `reading`."""
        self._index.used(scene_id)
        return self._files.keeping(scene_id)

    def ply(self, scene_id: str) -> bytes:
        """The .ply file. Raises `SceneNotFound`."""
        with self.reading(scene_id) as path:
            return path.read_bytes()

    def gaussians(self, scene_id: str) -> Gaussians:
        """The scene's Gaussians, from memory where they were used lately. Raises `SceneNotFound`."""
        with self.reading(scene_id) as path:
            return self._cache.get(scene_id, lambda: inspect_ply(path, dialect=STANDARD).gaussians)

    def page(self, limit: int, after: tuple[int, str] | None = None) -> Sequence[Indexed]:
        """Scenes, newest first, those of the same instant by id; behind `after` (created_ns, id)."""
        return self._index.page(limit, after)

    def totals(self) -> tuple[int, int]:
        """How many scenes, and their bytes."""
        return self._index.totals()

    def newest(self) -> str:
        """Id of the scene that was stored last. Raises `SceneNotFound` where there is none."""
        for row in self._index.page(PAGE):
            if self.exists(row.id):  # it may be damaged, or listed still after a crash while it was removed
                return row.id
        raise SceneNotFound(
            "the store holds no scene", field="scene", cure="POST /reconstruct makes one, POST /scenes loads one"
        )

    def writable(self) -> bool:
        """Whether a file can be made and removed, and the index takes rows."""
        return self._files.writable() and self.database.writable()

    def delete(self, scene_id: str) -> None:
        """Remove a scene, also one that was damaged or of which nothing is left but its place in the list. Raises
        `SceneNotFound`."""
        folder = self._files.folder(scene_id)
        with self._alone():
            there = os.path.lexists(folder)
            if there:
                self._files.remove(scene_id)
            if not self._index.remove([scene_id]) and not there:
                raise unknown(scene_id)
        self._cache.drop(scene_id)

    def evict_old(self) -> int:
        """Remove what nobody has read for `max_days`, and what is beyond `max_bytes`, but for what is being read now;
        returns how many. Last uses that lie ahead are set right first."""
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
        """One at a time changes what is there, so that list, folders and limits agree."""
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

    def _evict(self, row: Indexed) -> bool:
        try:
            if not self._files.remove(row.id, unless_read=True):
                return False
        except SceneNotFound:  # somebody else was faster
            pass
        self._index.remove([row.id])
        self._cache.drop(row.id)
        return True

    def _agree(self) -> None:
        """List the folders that are not listed, and no others."""
        there, listed = self._files.ids(), self._index.ids()
        self._index.remove(listed - there)
        self._list(there - listed)

    def _list(self, ids: Iterable[str]) -> None:
        """A folder that cannot be read, which a power cut may leave, is passed over and said."""
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
        "gaussians": document.get("gaussians", {}).get("count"),
        "views": len(document.get("view_cameras", ())),
        "file": file.get("format") if isinstance(file, Mapping) else None,
    }
