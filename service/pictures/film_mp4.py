"""H.264 in MP4 as every browser plays it: yuv420p in BT.709, with the index at the start. Needs PyAV."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.video.reformatter import ColorRange, Colorspace
from numpy.typing import NDArray

from ..errors import InputError

ENCODER = "libx264"
CRF = "18"  # one or two 8-bit levels in most pixels; the default, 23, is visible in flat areas
BT709 = 1  # ITU-T H.273 code of primaries and transfer function


def write_mp4(path: Path, width: int, height: int, fps: float, frames: Iterable[NDArray[np.uint8]]) -> None:
    """Encode frames (H, W, 3) of even sides at `fps` per second. Raises `InputError` without an encoder."""
    if ENCODER not in av.codecs_available:
        raise InputError(
            f"this PyAV has no {ENCODER}", field="format", cure="install PyAV from its wheel, or ask for webp"
        )
    with av.open(str(path), "w", format="mp4", options={"movflags": "+faststart"}) as container:
        stream: Any = container.add_stream(ENCODER, rate=Fraction(fps).limit_denominator(1001))
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.options = {"crf": CRF, "preset": "medium"}
        context = stream.codec_context
        context.color_range, context.colorspace = ColorRange.MPEG, Colorspace.ITU709
        context.color_primaries, context.color_trc = BT709, BT709
        for pixels in frames:
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels), format="rgb24")
            container.mux(
                stream.encode(
                    frame.reformat(format="yuv420p", dst_colorspace=Colorspace.ITU709, dst_color_range=ColorRange.MPEG)
                )
            )
        container.mux(stream.encode(None))
