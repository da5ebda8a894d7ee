"""A capture in a .zip, read without unpacking to disk; names, counts and sizes are checked first."""

from __future__ import annotations

import io
import posixpath
import stat
import struct
import zipfile
import zlib
from collections.abc import Sequence
from typing import BinaryIO, cast

from ..errors import CaptureError
from .files import is_clutter
from .names import LONGEST

MAX_MEMBERS = 20_000  # enough for 2,000 photographs at several sizes; each takes about a kilobyte of memory
MAX_DIRECTORY = 8 * 2**20  # bytes of the central directory, which is read as a whole
MAX_FOLDERS = 32  # above a file: each is an entry with its whole path
MAX_MEMBER_BYTES = 512 * 2**20  # of an unpacked file; a COLMAP model of 2,000 photographs is smaller
MAX_UNPACKED_BYTES = 4 * 2**30  # of all files that are read

SIGNATURES = (b"PK\x03\x04", b"PK\x05\x06")  # local file header, and end of central directory of an empty archive
_ARCHIVES = (".zip", ".tar", ".tgz", ".gz", ".bz2", ".xz", ".7z", ".rar", ".zst")
_END, _END64, _LOCATOR64 = b"PK\x05\x06", b"PK\x06\x06", b"PK\x06\x07"  # APPNOTE 4.3.14 to 4.3.16
_LONGEST_END = 22 + 65_535  # end of central directory with its comment
_ANEW, _ALONE = "zip the photographs and cameras anew", "zip the photographs and cameras alone"  # cures
_IS_UTF8 = 0x800  # APPNOTE 4.4.4, bit 11
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
# Exceptions of `zipfile` for damaged archives, of which BadZipFile is only one.
_DAMAGED = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    EOFError,
    OSError,
    NotImplementedError,
    RuntimeError,
    ValueError,
    OverflowError,
    IndexError,
)


class ZipFiles:
    """The files of a zip; `max_bytes` limits the sum of all unpacked bytes."""

    def __init__(self, stream: BinaryIO, label: str = "the zip", *, max_bytes: int = MAX_UNPACKED_BYTES) -> None:
        """Raises `CaptureError` for a file that is no zip, and for a zip with too many files or bytes, encryption,
        paths that leave it, duplicate files, nested archives or a compression other than deflate."""
        self._label = label
        self._max_bytes = max_bytes
        self._read = 0
        try:
            count = _check_directory(stream)
            self._zip = zipfile.ZipFile(stream)
            infos = self._zip.infolist()
            if len(infos) != count:
                raise zipfile.BadZipFile(f"{len(infos)} files were read of its list of {count}")
        except _DAMAGED as error:
            raise CaptureError(f"is not a readable zip: {error}", field="capture", cure=_ANEW) from error
        self._infos: dict[str, zipfile.ZipInfo] = {}
        self._folders: dict[str, set[str]] = {"": set()}
        self._files: dict[str, set[str]] = {"": set()}
        for info in infos:
            self._add(info)

    @property
    def label(self) -> str:
        return self._label

    def files(self, folder: str) -> Sequence[str]:
        return sorted(self._files.get(folder, ()))

    def folders(self, folder: str) -> Sequence[str]:
        return sorted(self._folders.get(folder, ()))

    def has(self, path: str) -> bool:
        return path in self._infos

    def size(self, path: str) -> int:
        return self._infos[path].file_size

    def open(self, path: str) -> BinaryIO:
        try:
            stream = self._zip.open(self._infos[path])
        except _DAMAGED as error:
            raise CaptureError(f"{path} cannot be unpacked: {error}", field="capture", cure=_ANEW) from error
        return cast(BinaryIO, io.BufferedReader(_Counted(self, path, cast(BinaryIO, stream))))

    def count(self, size: int) -> None:
        """Add to the unpacked bytes. Raises `CaptureError` beyond the limit."""
        self._read += size
        if self._read > self._max_bytes:
            message = f"unpacks to more than {self._max_bytes} bytes, the limit"
            raise CaptureError(message, field="capture", cure=_ALONE)

    def _add(self, info: zipfile.ZipInfo) -> None:
        name = _name(info).replace("\\", "/")  # written by some Windows archivers, against the format
        parts = name.rstrip("/").split("/")
        if not name or name.startswith("/") or ":" in parts[0] or {"", ".", ".."} & set(parts):
            message = f"has a file at {name!r}: paths must stay inside the zip"
            raise CaptureError(message, field="capture", cure=_ALONE)
        if len(name) > LONGEST or len(parts) > MAX_FOLDERS + 1:
            message = f"has a file at {name[:50]!r}..., {len(name)} characters in {len(parts) - 1} folders, "
            message += f"need at most {LONGEST} in {MAX_FOLDERS}"
            raise CaptureError(message, field="capture", cure=_ALONE)
        if any(is_clutter(part) for part in parts):
            return
        for depth in range(1, len(parts)):
            self._folders.setdefault("/".join(parts[: depth - 1]), set()).add(parts[depth - 1])
        if len(self._folders) > MAX_MEMBERS:
            message = f"has more than {MAX_MEMBERS} folders with folders in them"
            raise CaptureError(message, field="capture", cure=_ALONE)
        folder = "/".join(parts[:-1])
        if name.endswith("/"):
            self._folders.setdefault(folder, set()).add(parts[-1])
            return
        refusal, cure = _refusal(info), _ALONE
        if name in self._infos:
            refusal = "is there twice"
        elif stat.S_ISLNK(info.external_attr >> 16):
            refusal, cure = "is a symbolic link, which holds nothing but another name", "zip without -y"
        if refusal:
            raise CaptureError(f"{name!r} {refusal}", field="capture", cure=cure)
        self._infos[name] = info
        self._files.setdefault(folder, set()).add(parts[-1])


class _Counted(io.RawIOBase):
    """A stream of a member whose unpacked bytes are counted for the archive."""

    def __init__(self, owner: ZipFiles, path: str, stream: BinaryIO) -> None:
        self._owner, self._path, self._stream = owner, path, stream

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: object) -> int:
        view = memoryview(buffer)  # type: ignore[arg-type]
        try:
            data = self._stream.read(len(view))
        except _DAMAGED as error:
            raise CaptureError(f"{self._path} cannot be unpacked: {error}", field="capture", cure=_ANEW) from error
        self._owner.count(len(data))
        view[: len(data)] = data
        return len(data)

    def close(self) -> None:
        self._stream.close()
        super().close()


def _name(info: zipfile.ZipInfo) -> str:
    """As its archiver meant it: macOS, and Linux without a locale, write UTF-8 without the flag that says so, which
    `zipfile` takes for code page 437."""
    try:
        return info.filename if info.flag_bits & _IS_UTF8 else info.filename.encode("cp437").decode("utf-8")
    except UnicodeError:
        return info.filename


def _refusal(info: zipfile.ZipInfo) -> str | None:
    if info.flag_bits & 0x1:
        return "is encrypted"
    if posixpath.splitext(info.filename)[1].lower() in _ARCHIVES:
        return "is another archive"
    if info.compress_type not in _METHODS:
        return f"is compressed by method {info.compress_type}, need 0 (stored) or 8 (deflate)"
    if info.file_size > MAX_MEMBER_BYTES:
        return f"unpacks to {info.file_size} bytes, the limit is {MAX_MEMBER_BYTES}"
    return None


def _check_directory(stream: BinaryIO) -> int:
    """Number of entries in the central directory, checked and limited before `zipfile` creates an object for each.

    The positions and counts in the end records must be true, so that other readers cannot see other files: `zipfile`
    expects the zip64 record directly before its locator, and the directory directly before the end records, whatever
    these say. Raises `BadZipFile` and `CaptureError`.
    """
    size = stream.seek(0, io.SEEK_END)
    start = max(0, size - _LONGEST_END)
    stream.seek(start)
    tail = stream.read(_LONGEST_END)
    place = tail.rfind(_END)
    if place < 0 or len(tail) < place + 22:
        raise zipfile.BadZipFile("it has no list of files at its end; is it complete?")
    count, bytes_, offset = struct.unpack_from("<HII", tail, place + 10)
    end = start + place
    stream.seek(max(0, end - 20))
    locator = stream.read(20)
    if locator[:4] == _LOCATOR64:
        end -= 20 + 56
        said = struct.unpack_from("<Q", locator, 8)[0]
        stream.seek(max(0, end))
        record = stream.read(56)
        if said != end or record[:4] != _END64:
            raise zipfile.BadZipFile(
                f"its zip64 record is not where it should be: at byte {end}, its locator says {said}"
            )
        count, bytes_, offset = struct.unpack_from("<QQQ", record, 32)
    if count > MAX_MEMBERS:
        raise CaptureError(f"holds {count} files, the limit is {MAX_MEMBERS}", field="capture", cure=_ALONE)
    if bytes_ > MAX_DIRECTORY:
        message = f"its list of files has {bytes_} bytes, the limit is {MAX_DIRECTORY}"
        raise CaptureError(message, field="capture", cure=_ALONE)
    if offset != end - bytes_:
        raise zipfile.BadZipFile(f"its list of files starts at byte {end - bytes_}, its last record says {offset}")
    stream.seek(offset)
    found = _entries(stream.read(bytes_))
    if found != count:
        raise zipfile.BadZipFile(f"its list has {found} files, its last record says {count}")
    stream.seek(0)
    return count


def _entries(directory: bytes) -> int:
    """Number of entries in a central directory (APPNOTE 4.3.12). Raises `struct.error` for an incomplete one."""
    count = place = 0
    while place < len(directory):
        place += 46 + sum(struct.unpack_from("<3H", directory, place + 28))  # lengths of name, extra field and comment
        count += 1
    return count
