"""Scenes on disk: content-addressed folders that appear whole or not at all, with a cache of decoded Gaussians."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import shutil
import tempfile
import threading
import time
import uuid
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from .errors import SceneNotFound, StorageFull
from .file_lock import exclusive_if_free, shared
from .gaussians import Gaussians
from .gaussians_cache import GaussiansCache
from .ply import read_ply

CACHE_BYTES = 512 * 2**20
_ID = re.compile(r"[0-9a-f]{32}")
_TEMPORARY = ".incoming-"
_LOCK = ".lock"
_PLY = "scene.ply"
_DOCUMENT = "scene.json"
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_THERE = (errno.ENOTEMPTY, errno.EEXIST)


class SceneStore:
    """One folder per scene under `root`; safe for several threads and for several processes on one file system."""

    def __init__(self, root: str | Path, *, cache_bytes: int = CACHE_BYTES) -> None:
        """Make `root` if needed and remove what an interrupted `put` left there, unless somebody is writing now."""
        self.root = Path(root)
        self.root.mkdir(parents=True, exist_ok=True)
        self._cache = GaussiansCache(cache_bytes)
        self._clock = threading.Lock()
        self._last = 0
        with exclusive_if_free(self.root / _LOCK) as free:
            if free:
                for leftover in self.root.glob(f"{_TEMPORARY}*"):
                    shutil.rmtree(leftover, ignore_errors=True)

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

    def put(self, scene_id: str, ply: bytes, document: Mapping[str, Any]) -> None:
        """Store a scene: whole or nothing. A scene that is already there stays as it is.

        Raises `StorageFull` when the disk is, with nothing left behind.
        """
        target = self._folder(scene_id)
        if target.is_dir():
            return
        with shared(self.root / _LOCK), self._incoming() as folder:
            _write(folder / _PLY, ply)
            _write(folder / _DOCUMENT, json.dumps(document, allow_nan=False).encode())
            now = self._tick()
            os.utime(folder / _DOCUMENT, ns=(now, now))  # the order of `list`; a file system's own clock is coarser
            try:
                folder.rename(target)
            except OSError as error:
                if error.errno not in _THERE:
                    raise
            else:
                _sync_folder(self.root)

    def exists(self, scene_id: str) -> bool:
        """Whether the scene is there; False for what is no id at all."""
        return _ID.fullmatch(scene_id) is not None and (self.root / scene_id).is_dir()

    def document(self, scene_id: str) -> dict[str, Any]:
        """The scene's document. Raises `SceneNotFound`."""
        try:
            return json.loads((self._folder(scene_id) / _DOCUMENT).read_bytes())
        except FileNotFoundError as error:
            raise _unknown(scene_id) from error

    def ply_path(self, scene_id: str) -> Path:
        """The scene's .ply file. Raises `SceneNotFound`."""
        path = self._folder(scene_id) / _PLY
        if not path.is_file():
            raise _unknown(scene_id)
        return path

    def gaussians(self, scene_id: str) -> Gaussians:
        """The scene's Gaussians, from memory where they were used lately. Raises `SceneNotFound`."""
        path = self.ply_path(scene_id)
        try:
            return self._cache.get(scene_id, lambda: read_ply(path))
        except FileNotFoundError as error:  # deleted between the two lines
            raise _unknown(scene_id) from error

    def list(self) -> list[dict[str, Any]]:
        """All documents, newest first; scenes of the same instant by id."""
        documents = []
        for scene_id in self._ids():
            try:
                documents.append(self.document(scene_id))
            except SceneNotFound:  # deleted by somebody else meanwhile
                continue
        return documents

    def newest(self) -> str:
        """Id of the scene that was stored last. Raises `SceneNotFound` where there is none."""
        ids = self._ids()
        if not ids:
            raise SceneNotFound("the store holds no scene", field="scene", cure="POST /reconstruct makes one")
        return ids[0]

    def delete(self, scene_id: str) -> None:
        """Remove a scene. Raises `SceneNotFound`."""
        folder = self._folder(scene_id)
        with shared(self.root / _LOCK):
            trash = self.root / f"{_TEMPORARY}{scene_id}-{uuid.uuid4().hex}"
            try:
                folder.rename(trash)  # gone at once for every reader, even if removing takes long
            except FileNotFoundError as error:
                raise _unknown(scene_id) from error
            shutil.rmtree(trash, ignore_errors=True)
        self._cache.drop(scene_id)

    def _folder(self, scene_id: str) -> Path:
        """The folder of a well-formed id; nothing else ever becomes part of a path."""
        if _ID.fullmatch(scene_id) is None:
            raise _unknown(scene_id)
        return self.root / scene_id

    def _ids(self) -> Sequence[str]:
        stamped = []
        for entry in os.scandir(self.root):
            if _ID.fullmatch(entry.name) is not None:
                try:
                    stamped.append((-os.stat(Path(entry.path, _DOCUMENT)).st_mtime_ns, entry.name))
                except FileNotFoundError:  # deleted by somebody else meanwhile
                    continue
        return [scene_id for _, scene_id in sorted(stamped)]

    def _tick(self) -> int:
        """Nanoseconds since 1970, never twice the same in this process."""
        with self._clock:
            self._last = max(time.time_ns(), self._last + 1)
            return self._last

    @contextmanager
    def _incoming(self) -> Iterator[Path]:
        """A temporary folder beside the scenes; gone afterwards unless it was renamed."""
        folder: Path | None = None
        try:
            folder = Path(tempfile.mkdtemp(prefix=_TEMPORARY, dir=self.root))
            folder.chmod(0o755)  # other processes of the service may run as somebody else
            yield folder
        except OSError as error:
            if error.errno in _FULL:
                raise StorageFull(
                    f"no space for the scene: {error.strerror}",
                    field="store",
                    cure="delete scenes, or give it more room",
                ) from error
            raise
        finally:
            if folder is not None:
                shutil.rmtree(folder, ignore_errors=True)


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


def _write(path: Path, data: bytes) -> None:
    with path.open("xb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def _sync_folder(path: Path) -> None:
    """Make a rename survive a power cut."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _unknown(scene_id: str) -> SceneNotFound:
    return SceneNotFound(f"no scene {scene_id[:64]!r}", field="scene", cure="GET /scenes lists what there is")
