"""Scene folders: a .ply and a document, written atomically and locked while they are read. A damaged folder raises an
error that names the damage, can be deleted, and is replaced when its scene is written again."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import math
import os
import re
import shutil
import stat
import sys
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

from ..errors import FormatError, SceneNotFound
from ..process.disk import NO_FILE, full_is_refused, no_further_file, sync, write_file

PLY = "scene.ply"
DOCUMENT = "scene.json"
TEMPORARY = ".incoming-"  # of folders that are being written or deleted
_ID = re.compile(r"[0-9a-f]{32}")
# Members of a document that the service reads, and their types.
_KINDS = {"id": str, "gaussians": dict, "view_cameras": list, "warnings": list, "timings": dict}
_DEPTHS = ("near", "far")
_CAMERA = {"width", "height", "fx", "fy", "cx", "cy", "c2w"}
_ANEW = "delete it, or ask for it again with the same photographs or file"


def is_id(text: str) -> bool:
    """Whether it is 32 hex digits; nothing else may become part of a path."""
    return _ID.fullmatch(text) is not None


class SceneFiles:
    """The folders under `root`, one per scene."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def folder(self, scene_id: str) -> Path:
        """The folder of a well-formed id. Raises `SceneNotFound` for any other."""
        if not is_id(scene_id):
            raise unknown(scene_id)
        return self.root / scene_id

    def write(
        self,
        scene_id: str,
        ply: bytes,
        document: bytes,
        created_ns: int,
        inputs: Sequence[bytes] = (),
    ) -> bool:
        """Store a scene with its document as JSON and PNGs of its inputs, replacing a damaged one. Returns False if it
        exists already. Raises `StorageFull`, and leaves nothing behind then."""
        target, incoming = self.folder(scene_id), self._temporary(scene_id)
        with full_is_refused("the scene"):
            try:
                incoming.mkdir(mode=0o755)
                write_file(incoming / PLY, ply)
                for index, picture in enumerate(inputs):
                    write_file(incoming / _input(index), picture)
                write_file(incoming / DOCUMENT, document)
                os.utime(incoming / DOCUMENT, ns=(created_ns, created_ns))
                sync(incoming)
                try:
                    incoming.rename(target)
                except OSError:
                    if self.whole(scene_id):
                        return False
                    if not os.path.lexists(target):
                        raise
                    self.remove(scene_id)
                    incoming.rename(target)
                sync(self.root)
            finally:
                shutil.rmtree(incoming, ignore_errors=True)
        return True

    def whole(self, scene_id: str) -> bool:
        """Whether the scene exists, with Gaussians and a readable document."""
        try:
            self.document(scene_id)
        except (SceneNotFound, FormatError):
            return False
        return True

    def document(self, scene_id: str) -> dict[str, Any]:
        """The document of a scene. Raises `SceneNotFound`, and `FormatError` for a damaged scene."""
        folder = self.folder(scene_id)
        try:
            _require_gaussians(scene_id, (folder / PLY).stat())
            if not os.access(folder / PLY, os.R_OK):  # it belongs to another user, as after a restore
                raise _unreadable(scene_id, PLY, PermissionError(errno.EACCES, os.strerror(errno.EACCES)))
            text = (folder / DOCUMENT).read_bytes()
            document = json.loads(text, parse_constant=_finite, parse_float=_finite)
        except (FileNotFoundError, NotADirectoryError) as error:
            if (folder / PLY).is_file():
                raise _damaged(scene_id, f"{DOCUMENT} is missing") from error
            raise self._missing(scene_id) from error
        except (IsADirectoryError, PermissionError) as error:
            raise _unreadable(scene_id, DOCUMENT, error) from error
        except (ValueError, RecursionError) as error:
            raise _damaged(scene_id, f"{DOCUMENT} is no JSON: {error}") from error
        if not isinstance(document, dict):
            raise _damaged(scene_id, f"{DOCUMENT} holds no object")
        if wrong := _wrong_member(document, scene_id):
            raise _damaged(scene_id, f"{wrong} in {DOCUMENT}")
        return document

    def size(self, scene_id: str) -> tuple[int, int]:
        """Bytes of all files, and time of creation in ns since 1970. Raises `FileNotFoundError`."""
        folder = self.folder(scene_id)
        files = sum(entry.stat().st_size for entry in os.scandir(folder))
        return files, (folder / DOCUMENT).stat().st_mtime_ns

    def input(self, scene_id: str, index: int) -> bytes:
        """A photograph as the scene has it, as PNG. Raises `SceneNotFound`, also for an input that does not exist."""
        try:
            return (self.folder(scene_id) / _input(index)).read_bytes()
        except PermissionError as error:
            raise _unreadable(scene_id, _input(index), error) from error
        except (FileNotFoundError, NotADirectoryError) as error:
            if not self.folder(scene_id).is_dir():
                raise unknown(scene_id) from error
            count = len(list(self.folder(scene_id).glob(_input("*"))))
            there = f"0 to {count - 1}" if count else "none: the scene was loaded from a file"
            raise SceneNotFound(f"scene {scene_id!r} has no input {index}", field="index", cure=there) from error

    @contextmanager
    def reading(self, scene_id: str) -> Iterator[Path]:
        """The path of the .ply, which is not evicted during the block. Raises `SceneNotFound`, also if it is deleted
        meanwhile, and `FormatError` if it is empty."""
        with self.keeping(scene_id):
            try:
                yield self.folder(scene_id) / PLY
            except FileNotFoundError as error:
                raise unknown(scene_id) from error

    @contextmanager
    def keeping(self, scene_id: str) -> Iterator[None]:
        """The scene is not evicted during the block. Raises as `reading`, on entry only: errors of the block pass
        unchanged."""
        path = self.folder(scene_id) / PLY
        try:
            handle = os.open(path, os.O_RDONLY)
        except (FileNotFoundError, NotADirectoryError) as error:
            raise self._missing(scene_id) from error
        except PermissionError as error:
            raise _unreadable(scene_id, PLY, error) from error
        try:
            fcntl.flock(handle, fcntl.LOCK_SH)
            if not _same(handle, path):  # deleted or replaced before it was locked
                raise unknown(scene_id)
            _require_gaussians(scene_id, os.fstat(handle))
            yield
        finally:
            os.close(handle)

    def remove(self, scene_id: str, *, unless_read: bool = False) -> bool:
        """Delete a scene, atomically for readers; returns False if `unless_read` and somebody reads it.

        Raises `SceneNotFound`.
        """
        folder, trash = self.folder(scene_id), self._temporary(scene_id)
        try:
            with _unread(folder / PLY) if unless_read else nullcontext():
                folder.rename(trash)
        except BlockingIOError:
            return False
        except FileNotFoundError as error:
            raise unknown(scene_id) from error
        _drop(trash)
        return True

    def ids(self) -> set[str]:
        """Ids of all folders."""
        return {entry.name for entry in os.scandir(self.root) if is_id(entry.name)}

    def writable(self) -> bool:
        """Whether a file of one page (4096 bytes) can be written. Raises `ServiceBusy` if no further file may be
        opened."""
        probe = self.root / f"{TEMPORARY}{uuid.uuid4().hex}"
        try:
            probe.write_bytes(bytes(4096))
            probe.unlink(missing_ok=True)  # another process may have swept it
        except OSError as error:
            with contextlib.suppress(OSError):
                probe.unlink()
            if error.errno in NO_FILE:
                raise no_further_file() from error
            return False
        return True

    def sweep(self) -> None:
        """Delete what an interrupted `write` or `remove` has left. No other process may be writing meanwhile."""
        for leftover in self.root.glob(f"{TEMPORARY}*"):
            _drop(leftover)

    def _missing(self, scene_id: str) -> SceneNotFound:
        if not self.folder(scene_id).is_dir():
            return unknown(scene_id)
        return SceneNotFound(f"of scene {scene_id} the Gaussians are gone", field="scene", cure=_ANEW)

    def _temporary(self, scene_id: str) -> Path:
        return self.root / f"{TEMPORARY}{scene_id}-{uuid.uuid4().hex}"


def _input(index: int | str) -> str:
    return f"input_{index}.png"


@contextmanager
def _unread(path: Path) -> Iterator[None]:
    """Lock the .ply against readers during the block. Raises `BlockingIOError` if somebody reads it."""
    handle = None
    with contextlib.suppress(FileNotFoundError, NotADirectoryError, PermissionError):  # then nobody can read it
        handle = os.open(path, os.O_RDONLY)
    try:
        if handle is not None:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        if handle is not None:
            os.close(handle)


def _same(handle: int, path: Path) -> bool:
    """Whether the open file is still the one at `path`."""
    try:
        return os.path.samestat(os.fstat(handle), path.stat())
    except (FileNotFoundError, NotADirectoryError):
        return False


def _drop(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def _finite(text: str) -> float:
    if not math.isfinite(value := float(text)):
        raise ValueError(f"{text} is no number of it")
    return value


def _wrong_member(document: dict[str, Any], scene_id: str) -> str | None:
    """What is missing or of another type among the members that the service reads, None where all is well."""
    for name in (*_KINDS, *_DEPTHS):
        if name not in document:
            return f"{name} is missing"
    for name, kind in _KINDS.items():
        if not isinstance(document[name], kind):
            return f"{name} is no {kind.__name__}"
    if document["id"] != scene_id:
        return f"id is {document['id'][:64]!r}"
    if not all(isinstance(camera, dict) and camera.keys() >= _CAMERA for camera in document["view_cameras"]):
        return "a member of view_cameras is no camera"
    if not all(document[name] is None or (_is_number(document[name]) and document[name] > 0) for name in _DEPTHS):
        return "near or far is no depth"
    inputs = document.get("inputs", 0)
    return None if type(inputs) is int and inputs >= 0 else "inputs is no count"


def _is_number(value: object) -> bool:
    return type(value) in (int, float) and abs(value) <= sys.float_info.max  # type: ignore[arg-type]


def _require_gaussians(scene_id: str, ply: os.stat_result) -> None:
    if not (stat.S_ISREG(ply.st_mode) and ply.st_size):
        raise _damaged(scene_id, f"{PLY} holds nothing")


def _damaged(scene_id: str, what: str) -> FormatError:
    return FormatError(f"the stored scene {scene_id} cannot be read: {what}", field="scene", cure=_ANEW)


def _unreadable(scene_id: str, name: str, error: OSError) -> FormatError:
    return _damaged(scene_id, f"{name} cannot be read: {error.strerror}")


def unknown(scene_id: str) -> SceneNotFound:
    return SceneNotFound(f"no scene {scene_id[:64]!r}", field="scene", cure="GET /scenes lists what there is")
