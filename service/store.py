"""The scenes of a service: content-addressed folders, an index over them, limits with eviction, a cache in memory."""

from __future__ import annotations

import hashlib
import json
import logging
import threading
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

from .database import Database
from .errors import GapmesError, SceneNotFound, StorageFull
from .file_lock import exclusive, exclusive_if_free, shared
from .formats.dialect import STANDARD
from .gaussians import Gaussians
from .gaussians_cache import GaussiansCache
from .ply import inspect_ply
from .scene_files import SceneFiles, is_id
from .scene_index import Indexed, SceneIndex

CACHE_BYTES = 512 * 2**20
PAGE = 100
DAY_NS = 86_400 * 10**9
_LOCK = ".lock"
_WRITING = ".writing"
_INDEX = "index.sqlite"
_log = logging.getLogger("gapmes")


class SceneStore:
    """One folder per scene under `root`; safe for several threads and for several processes on one file system."""

    def __init__(
        self,
        root: str | Path,
        *,
        cache_bytes: int = CACHE_BYTES,
        max_bytes: int | None = None,
        max_days: float | None = None,
    ) -> None:
        """Make `root` if needed, list what it holds, and remove what a crash left there unless somebody writes.

        Beyond `max_bytes` the scenes go that were read longest ago; those that nobody has read for `max_days` go too.
        Raises `GapmesError` where the folder cannot be made or written, or its index belongs to a later version.
        """
        self.root = Path(root)
        self.max_bytes, self.max_days = max_bytes, max_days
        self._files = SceneFiles(self.root)
        self._cache = GaussiansCache(cache_bytes)
        self._clock = threading.Lock()
        self._last = 0
        try:
            self.root.mkdir(parents=True, exist_ok=True)
            self.database = Database(self.root / _INDEX)
            self._index = SceneIndex(self.database)
            with exclusive_if_free(self.root / _LOCK) as free:
                if free:
                    self._files.sweep()
                    self._agree()
        except OSError as error:
            raise GapmesError(
                f"{self.root} cannot be used: {error.strerror}",
                field="store",
                cure="let GAPMES_STORE or --store name a folder that this user may write",
            ) from error

    @staticmethod
    def scene_id(model_sha256: str, images: Sequence[bytes], cameras_json: object, options: Mapping[str, Any]) -> str:
        """32 hex characters of the sha256 over all inputs, each with its length in front, so that none can run into
        the next. Equal JSON gives equal ids whatever the order of keys, and 512 is 512.0."""
        digest = hashlib.sha256()
        parts = [model_sha256.encode(), _canonical(cameras_json), _canonical(options), *images]
        for part in parts:
            digest.update(len(part).to_bytes(8, "big"))
            digest.update(part)
        return digest.hexdigest()[:32]

    def put(self, scene_id: str, ply: bytes, document: Mapping[str, Any], inputs: Sequence[bytes] = ()) -> None:
        """Store a scene, with PNGs of its inputs: whole or nothing. One that is already there stays as it is.

        Raises `StorageFull` when the disk is, or when `max_bytes` is reached and all that is there is being read.
        """
        with self._alone():
            new = not self._files.folder(scene_id).is_dir()
            if new:
                text = json.dumps(document, allow_nan=False).encode()
                self._make_room(len(ply) + len(text) + sum(map(len, inputs)))
                self._files.write(scene_id, ply, text, self._tick(), inputs)
            try:
                self._list([scene_id])
            except BaseException:
                if new:
                    self._files.remove(scene_id)
                raise

    def listed(self, scene_id: str) -> bool:
        """Whether the scene is there; then it is in the list too, whatever a crash has left out."""
        if self.exists(scene_id):
            with self._alone():
                self._list([scene_id])
        return self.exists(scene_id)

    def exists(self, scene_id: str) -> bool:
        """Whether the scene is there; False for what is no id at all."""
        return is_id(scene_id) and (self.root / scene_id).is_dir()

    def document(self, scene_id: str) -> dict[str, Any]:
        """The scene's document. Raises `SceneNotFound`."""
        self._index.used(scene_id)
        return self._files.document(scene_id)

    def input(self, scene_id: str, index: int) -> bytes:
        """A PNG of what the network saw of a photograph. Raises `SceneNotFound`, also where there is none."""
        self._index.used(scene_id)
        return self._files.input(scene_id, index)

    def reading(self, scene_id: str) -> AbstractContextManager[Path]:
        """The scene's .ply file, which is not evicted during the block. Raises `SceneNotFound`."""
        self._index.used(scene_id)
        return self._files.reading(scene_id)

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
            if self.exists(row.id):  # a crash while it was removed may have left it listed
                return row.id
        raise SceneNotFound(
            "the store holds no scene", field="scene", cure="POST /reconstruct makes one, POST /scenes loads one"
        )

    def writable(self) -> bool:
        """Whether a file can be made and removed."""
        return self._files.writable()

    def delete(self, scene_id: str) -> None:
        """Remove a scene. Raises `SceneNotFound`."""
        with self._alone():
            self._files.remove(scene_id)
            self._index.remove([scene_id])
        self._cache.drop(scene_id)

    def evict_old(self) -> int:
        """Remove what nobody has read for `max_days` and nobody is reading now; returns how many."""
        if self.max_days is None:
            return 0
        before = time.time_ns() - int(self.max_days * DAY_NS)
        with self._alone():
            return sum(self._evict(row) for row in self._index.longest_unused(before))

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
        unused = iter(self._index.longest_unused() if self.totals()[1] + more > self.max_bytes else ())
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
            except (SceneNotFound, OSError, ValueError) as error:
                _log.warning("scene %s cannot be read and is not listed: %s", scene_id, error)
                continue
            summary = _summary(scene_id, document)
            rows.append(Indexed(scene_id, created_ns, max(created_ns, time.time_ns()), size, summary))
        self._index.add(rows)

    def _tick(self) -> int:
        """Nanoseconds since 1970, never twice the same in this process."""
        with self._clock:
            self._last = max(time.time_ns(), self._last + 1)
            return self._last


def _summary(scene_id: str, document: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "id": scene_id,
        "created": document.get("created"),
        "gaussians": document.get("gaussians", {}).get("count"),
        "views": len(document.get("view_cameras", ())),
        "file": (document.get("file") or {}).get("format"),
    }


def _canonical(value: object) -> bytes:
    return json.dumps(_plain(value), sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def _plain(value: object) -> object:
    """Tuples as lists, whole numbers as floats: what JSON cannot tell apart must not tell ids apart."""
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) <= 2**53:
        return float(value)
    return value
