"""A PNG whose colour profile or texts are longer than the decoder takes is refused for that, not as half an upload."""

from __future__ import annotations

import io
from typing import Any

import pytest
from PIL import Image, PngImagePlugin

from gapmes.service.errors import ImageUnreadable
from gapmes.service.photographs.images import decode_image

MANY = 3_000_000


def texts(count: int, length: int, *, packed: bool) -> PngImagePlugin.PngInfo:
    found = PngImagePlugin.PngInfo()
    for index in range(count):
        found.add_text(f"key {index}", "x" * length, zip=packed)
    return found


@pytest.mark.parametrize(
    "saved",
    [
        {"icc_profile": bytes(MANY)},
        {"pnginfo": texts(1, MANY, packed=True)},
        {"pnginfo": texts(70, 1_000_000, packed=True)},
    ],
)
def test_what_is_too_long_is_named(saved: dict[str, Any]) -> None:
    buffer = io.BytesIO()
    Image.new("RGB", (64, 64), (90, 120, 30)).save(buffer, "PNG", **saved)
    with pytest.raises(ImageUnreadable, match="unpack to more than 1048576 bytes, or 67108864 together") as caught:
        decode_image(buffer.getvalue(), index=2)
    assert (caught.value.field, caught.value.index, caught.value.cure) == ("images", 2, "save it without them")
