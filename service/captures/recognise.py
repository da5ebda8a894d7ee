"""Recognising a capture by content: which file holds the cameras, and in which format."""

from __future__ import annotations

import posixpath
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from ..cameras.camera_fields import CameraFile, SizeOf
from ..cameras.camera_file import parse_camera_file, view_names
from ..errors import CameraError, CaptureError
from ..unique_members import CURE, RepeatedMember, parsed
from .colmap import has_colmap, is_of_colmap, is_whole, read_colmap
from .colmap_models import (
    image_counts,
    largest_model,
    models_below,
    numbered_alone,
    parts_of_models,
    places_of_models,
    several_models,
)
from .files import Files, joined, read_bounded
from .llff import SIGNATURE, read_llff
from .photographs import is_photograph
from .realestate10k import looks_like_realestate10k, read_realestate10k
from .table import CameraTable

JSON_NAMES = ("cameras.json", "transforms.json", "transforms_train.json")
COLMAP_FOLDERS = ("sparse/0", "sparse", "colmap/sparse/0", "colmap/sparse", "")  # before other folders with a model
LLFF_NAME = "poses_bounds.npy"
BEFORE_JSON = b"\xef\xbb\xbf \t\r\n"  # a byte order mark, and blanks
MAX_CAMERA_BYTES = 64 * 2**20  # of a camera file that is read whole

KNOWN = f"{', '.join(JSON_NAMES)}, a COLMAP model (sparse/0), {LLFF_NAME} or a RealEstate10K .txt"

Parse = Callable[[bytes], Any]  # a decoded JSON file. Raises `ValueError` or `RecursionError`, or an error of the tree


def recognised(files: Files, max_bytes: int = MAX_CAMERA_BYTES) -> tuple[str, CameraTable]:
    """The folder of the capture, the root or one of its folders, and its cameras. A root that holds numbered COLMAP
    models and nothing else, as `sparse` of a project, is itself the capture.

    In a folder the first of these is read: cameras.json, transforms.json, transforms_train.json, a COLMAP model,
    poses_bounds.npy, a single RealEstate10K text. Raises `CaptureError` if there is none, if several folders have one
    (before any is read), and for a file of more than `max_bytes` that is read as a whole.
    """
    read = _reader_in(files, "", max_bytes)
    if read is not None:
        return "", read()
    readers = ((folder, _reader_in(files, folder, max_bytes)) for folder in files.folders(""))
    found = [(folder, read) for folder, read in readers if read is not None]
    if len(found) == 1:
        folder, read = found[0]
        return folder, read()
    if models := numbered_alone(files, [folder for folder, _ in found]):
        return "", _colmap(files, models, models[0])
    if found:
        listed = ", ".join(folder for folder, _ in found[:5])
        raise CaptureError(
            f"{files.label} holds {len(found)} captures: {listed}", field="capture", cure="give one of them"
        )
    raise _nothing(files)


def _nothing(files: Files) -> CaptureError:
    """The refusal of a capture without cameras."""
    folders = files.folders("")
    places = [place for base in ("", *folders) for place in places_of_models(files, base)]
    if part := parts_of_models(files, places):
        cure = "copy or export the model with all its files"
        return CaptureError(f"{files.label} holds no whole COLMAP model: {part}", field="capture", cure=cure)
    there = [f"{name}/" for name in folders] + list(files.files(""))
    found_instead = f"holds no cameras, only {', '.join(there[:8])}" if there else "is empty"
    cure = f"it needs one of {KNOWN}"
    if any(is_photograph(name) for folder in ("", *folders) for name in files.files(folder)):
        cure += "; COLMAP computes cameras from photographs: colmap automatic_reconstructor"
    return CaptureError(f"{files.label} {found_instead}", field="capture", cure=cure)


def table_of_file(files: Files, path: str, max_bytes: int = MAX_CAMERA_BYTES) -> CameraTable:
    """The cameras of a named file, whatever its name is. A file of a COLMAP model stands for the model, in the file's
    own form. Raises `CameraError`, and `CaptureError` for more than `max_bytes`.
    """
    folder, name = posixpath.split(path)
    if is_of_colmap(name):
        form = name[-3:]
        if not is_whole(files, folder, form):
            message = f"{path} is not in a whole COLMAP model, need cameras.{form} and images.{form} beside it"
            raise CameraError(message, field="cameras", cure="copy or export the model with all its files")
        return read_colmap(files, folder, form)
    return table_of_bytes(read_bounded(files, path, max_bytes), path)


def table_of_bytes(data: bytes, source: str, parse: Parse = parsed) -> CameraTable:
    """The cameras of a file by its content: .npy, text of RealEstate10K, else JSON. Raises `CameraError`, or what
    `parse` raises of its own.
    """
    if data.startswith(SIGNATURE):
        return read_llff(data, source)
    if looks_like_realestate10k(data):
        return read_realestate10k(data, source)
    try:
        obj = parse(data)
    except RepeatedMember as error:
        raise CameraError(f"{source} {error}", field="cameras", cure=CURE) from error
    except (ValueError, RecursionError) as error:
        message, cure = f"{source} is not readable JSON: {error}", "is it the camera file, and complete?"
        if data.lstrip(BEFORE_JSON)[:1] not in b"{[":  # a photograph or a .ply, say
            message = f"{source} is no camera file, it begins with {data[:8]!r}"
            cure = f"give a folder, a .zip, or one of {KNOWN}"
        raise CameraError(message, field="cameras", cure=cure) from error
    kind, names = view_names(obj)

    def cameras(indices: Sequence[int], size_of: SizeOf | None) -> CameraFile:
        return parse_camera_file(obj, size_of=size_of, indices=indices)

    return CameraTable(kind, source, names, cameras)


def _reader_in(files: Files, base: str, max_bytes: int) -> Callable[[], CameraTable] | None:
    lists = []
    for path in (joined(base, name) for name in JSON_NAMES):
        if files.has(path):
            if not _is_list(files, path):
                return partial(table_of_file, files, path, max_bytes)
            lists.append(path)
    for folder in (*(joined(base, folder) for folder in COLMAP_FOLDERS), *models_below(files, base)):
        if has_colmap(files, folder) is not None:
            return partial(_colmap, files, models_below(files, base), folder)
    if files.has(joined(base, LLFF_NAME)):
        return partial(table_of_file, files, joined(base, LLFF_NAME), max_bytes)
    texts = [joined(base, name) for name in files.files(base) if name.endswith(".txt")]
    texts = [path for path in texts if _is_realestate10k(files, path)]
    if len(texts) > 1:
        message = f"{files.label} holds {len(texts)} RealEstate10K files: {', '.join(texts[:5])}"
        raise CaptureError(message, field="capture", cure="keep one of them")
    last = (*texts, *lists)
    return partial(table_of_file, files, last[0], max_bytes) if last else None


def _colmap(files: Files, models: Sequence[str], first: str) -> CameraTable:
    counts = image_counts(files, models, first)
    folder = largest_model(counts, first)
    form = has_colmap(files, folder) or "bin"
    table = read_colmap(files, folder, form)
    return replace(table, warnings=(*several_models(files, counts, folder), *table.warnings))


def _is_list(files: Files, path: str) -> bool:
    """Whether a JSON file is a list, the cameras.json of 3DGS training, which has the lowest priority."""
    with files.open(path) as stream:
        return stream.read(64).lstrip(BEFORE_JSON)[:1] == b"["


def _is_realestate10k(files: Files, path: str) -> bool:
    with files.open(path) as stream:
        return looks_like_realestate10k(stream.read(4096))
