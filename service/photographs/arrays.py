"""Photographs given as arrays: of 8-bit RGB, or refused with what makes them so."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import ImageError


def checked_pixels(array: object, index: int | None) -> NDArray[np.uint8]:
    """(H, W, 3) or (H, W, 4) uint8. Raises `ImageError` for anything else."""
    try:
        pixels = np.asarray(array)
    except (TypeError, ValueError, RuntimeError) as error:  # torch raises the last for its gradients
        message = f"is a {type(array).__name__} that gives no array: {error!s:.200}"
        cure = "give 8-bit RGB with the channels last"
        raise ImageError(message, field="images", index=index, cure=cure) from error
    if pixels.dtype == np.uint8 and pixels.ndim == 3 and pixels.shape[2] in (3, 4):
        return pixels
    what = f"array is {pixels.dtype} of shape {pixels.shape}"
    cure = "give 8-bit RGB with the channels last"
    if pixels.dtype.hasobject:
        what = f"is a {type(array).__name__}"
        cure = "give a path, the bytes of a file, or an array of 8-bit RGB with the channels last"
        if hasattr(array, "read"):
            cure = "give what its read() returns, from the beginning of a file opened for bytes, or the file's path"
    elif pixels.dtype.kind == "f":
        cure += "; np.rint(255 * array).astype(np.uint8) where it is 0 to 1"
    elif pixels.dtype.kind == "u" and pixels.dtype.itemsize == 2:
        cure += "; np.rint(array / 257).astype(np.uint8) where it is of 16 bits"
    elif pixels.dtype == np.uint8 and pixels.ndim == 1:
        cure = "are these the bytes of a file? give them as bytes, such as by tobytes()"
    elif pixels.dtype == np.uint8 and pixels.ndim == 2:
        cure = "of a grey photograph give np.stack([array] * 3, axis=-1)"
    elif pixels.dtype == np.uint8 and pixels.ndim == 3 and pixels.shape[2] == 1:
        cure = "of a grey photograph give np.repeat(array, 3, axis=-1)"
    elif pixels.dtype == np.uint8 and pixels.ndim == 3 and pixels.shape[0] in (3, 4):
        cure = "put the channels last: array.transpose(1, 2, 0)"
    raise ImageError(f"{what}, need uint8 (H, W, 3) or (H, W, 4)", field="images", index=index, cure=cure)
