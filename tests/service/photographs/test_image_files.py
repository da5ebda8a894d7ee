"""The cost of a file before it is decoded: scans of a JPEG, pixels of several photographs together."""

import io
import re
import struct
import tracemalloc
import warnings
import zlib

import numpy as np
import pytest
from PIL import Image

from gapmes.service.errors import ImageError, ImageTooLarge, ImageUnreadable
from gapmes.service.photographs.image_files import (
    FEW_PARTS,
    MAX_SEGMENTS,
    check_total,
    image_size,
    jpeg_parts,
    open_image,
)
from gapmes.service.photographs.images import decode_image

START_OF_SCAN, END_OF_IMAGE = b"\xff\xda", b"\xff\xd9"


def encoded(kind="JPEG", width=64, height=48, **options):
    buffer = io.BytesIO()
    pixels = np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(buffer, kind, **options)
    return buffer.getvalue()


def with_scans(count: int) -> bytes:
    """A progressive JPEG that repeats its last scan until it has `count`; decoders decode every one of them."""
    data = encoded(progressive=True)
    body, last = data[:-2], data[data.rindex(START_OF_SCAN) : -2]
    return body + last * (count - jpeg_parts(data)[0]) + END_OF_IMAGE


@pytest.mark.parametrize(("options", "expected"), [({}, 1), ({"progressive": True}, 10)])
def test_scans_are_counted(options, expected):
    assert jpeg_parts(encoded(**options))[0] == expected
    assert jpeg_parts(encoded(quality=98, restart_marker_blocks=1, **options))[0] == expected


def test_a_jpeg_of_hundreds_of_scans_is_refused_with_both_numbers():
    assert decode_image(with_scans(100), index=0).width == 64
    for count in (101, 700):
        with pytest.raises(ImageError, match="JPEG of 101 scans or more, the limit is 100") as caught:
            decode_image(with_scans(count), index=2)
        assert (caught.value.status, caught.value.index) == (422, 2)


@pytest.mark.parametrize("behind", [2, -2])
def test_a_jpeg_of_countless_empty_segments_is_refused_before_it_is_parsed(behind):
    """Before the first scan they keep the header's parser busy, behind it the count itself."""
    data = encoded()
    for count, most in ((700, FEW_PARTS + (len(data) + 4 * 700) // 256), (MAX_SEGMENTS + 1, 700)):
        padded = data[:behind] + b"\xff\xe0\x00\x02" * count + data[behind:]
        with pytest.raises(ImageError, match=r"JPEG of (\d+) segments or more, the limit is (\d+)") as caught:
            open_image(padded, index=1)
        told, limit = (int(word) for word in re.findall(r"\d+", caught.value.message))
        assert told == limit + 1 <= most + 1
    assert max(jpeg_parts(data)) < 20


def test_a_large_jpeg_has_no_more_segments_than_any_may_have():
    """Those of a film of depths that a telephone appends are of 64 KiB each."""
    data = encoded()
    room = b"\xff\xe0\xff\xff" + bytes(65533)
    many = data[:2] + room * 50 + b"\xff\xe0\x00\x02" * MAX_SEGMENTS + data[2:]
    with pytest.raises(ImageError, match=f"JPEG of {MAX_SEGMENTS + 1} segments or more, the limit is {MAX_SEGMENTS}"):
        open_image(many, index=1)
    some = data[:2] + (room + b"\xff\xe0\x00\x02" * 200) * 40 + data[2:]
    assert image_size(some, index=0) == (64, 48)


def test_a_png_of_countless_empty_chunks_is_refused_before_it_is_parsed():
    """Each costs the decoder's parser an iteration, and those of private kinds stay in memory."""
    data = encoded("PNG")
    empty = bytes(4) + b"abCd" + zlib.crc32(b"abCd").to_bytes(4, "big")
    most = FEW_PARTS + (len(data) + len(empty) * 600) // 256
    assert most < 600
    with pytest.raises(ImageError, match=f"is a PNG of {most + 1} chunks or more, the limit is {most}") as caught:
        open_image(data[:33] + empty * 600 + data[33:], index=1)
    assert (caught.value.status, caught.value.index) == (422, 1)
    some = data[:33] + empty * 450 + data[33:]
    np.testing.assert_array_equal(decode_image(some, index=0).rgb, decode_image(data, index=0).rgb)


def test_a_webp_of_countless_empty_chunks_is_refused_before_it_is_parsed():
    """Each takes six times its bytes for as long as the file is open. What is behind the end does not count."""
    data = encoded("WEBP", exif=b"II*\0" + struct.pack("<IHI", 8, 0, 0))

    def with_chunks(count):
        body = data[8:] + b"abCd" + struct.pack("<I", 3) + b"odd\0" + (b"abCd" + bytes(4)) * count
        return b"RIFF" + struct.pack("<I", len(body)) + body

    most = FEW_PARTS + len(with_chunks(600)) // 256
    assert most < 600
    with pytest.raises(ImageError, match=f"is a WebP of {most + 1} chunks or more, the limit is {most}") as caught:
        open_image(with_chunks(600), index=1)
    assert (caught.value.status, caught.value.index) == (422, 1)
    for fine in (with_chunks(450), data + bytes(50_000)):
        np.testing.assert_array_equal(decode_image(fine, index=0).rgb, decode_image(data, index=0).rgb)


def test_what_stands_behind_the_end_of_a_png_is_not_counted():
    """Memory cards and recovery programs fill the last block with zeros, which look like empty chunks."""
    data = encoded("PNG")
    padded = data + bytes(50_000)
    assert image_size(padded, index=0) == (64, 48)
    np.testing.assert_array_equal(decode_image(padded, index=0).rgb, decode_image(data, index=0).rgb)


def test_a_png_whose_rest_was_not_copied_is_damaged():
    """A file that was made at its full length has zeros from there on: no chunks, whose number would be told."""
    data = encoded("PNG")
    with pytest.raises(ImageUnreadable, match="cannot be decoded"):
        decode_image(data[: data.index(b"IDAT") + 20] + bytes(50_000), index=0)


def test_pixels_may_come_in_as_many_chunks_as_encoders_write():
    """Of 512 bytes each, a sixteenth of what they do."""
    data = encoded("PNG", 1600, 1600)
    begin, end = data.index(b"IDAT") - 4, data.rindex(b"IEND") - 4
    pixels, place = b"", begin
    while place < end:
        length = int.from_bytes(data[place : place + 4], "big")
        pixels += data[place + 8 : place + 8 + length]
        place += 12 + length
    pieces = [b"IDAT" + pixels[place : place + 512] for place in range(0, len(pixels), 512)]
    assert len(pieces) > 20 * FEW_PARTS
    chunks = [(len(one) - 4).to_bytes(4, "big") + one + zlib.crc32(one).to_bytes(4, "big") for one in pieces]
    fine = data[:begin] + b"".join(chunks) + data[end:]
    np.testing.assert_array_equal(decode_image(fine, index=0).rgb, decode_image(data, index=0).rgb)


def test_what_only_looks_like_a_scan_does_not_count():
    """Bytes of metadata, and of the film that some telephones append to their photographs."""
    data = encoded()
    payload = START_OF_SCAN * 2000
    comment = b"\xff\xe5" + (len(payload) + 2).to_bytes(2, "big") + payload
    odd = data[:2] + comment + data[2:] + payload
    assert jpeg_parts(odd)[0] == 1
    np.testing.assert_array_equal(decode_image(odd, index=0).rgb, decode_image(data, index=0).rgb)


@pytest.mark.parametrize("data", [b"", b"\xff", b"\xff\xd8\xff", b"\xff\xda", b"\xff" * 1000, b"\xff\xda\xff\xff"])
def test_counting_ends_on_anything(data):
    assert jpeg_parts(data)[0] <= 1


def test_size_comes_from_the_header():
    assert image_size(encoded("PNG", 70, 50)[:60], index=0) == (70, 50)
    with pytest.raises(ImageUnreadable):
        image_size(b"nothing", index=0)
    with pytest.raises(ImageTooLarge, match="70 x 50 = 3500 pixels, the limit is 3499"):
        image_size(encoded("PNG", 70, 50), index=0, max_pixels=3499)


def test_photographs_are_bounded_together():
    photos = [encoded("PNG", 70, 50), encoded("PNG", 40, 40), encoded("JPEG", 40, 40)]
    check_total(photos, max_pixels=3500, max_total=6700)
    with pytest.raises(ImageTooLarge, match="the 3 photographs have 6700 pixels together, the limit is 6699") as caught:
        check_total(photos, max_pixels=3500, max_total=6699)
    assert caught.value.status == 413
    with pytest.raises(ImageTooLarge) as caught:
        check_total(photos, max_pixels=3499, max_total=10**9)
    assert caught.value.index == 0
    with pytest.raises(ImageTooLarge) as caught:
        check_total(photos[::-1], max_pixels=3499, max_total=10**9, numbers=(4, 7, 9))
    assert caught.value.index == 9


def test_every_sixteen_bit_level_is_rounded():
    levels = np.arange(65536, dtype=np.uint16).reshape(512, 128)  # more rows than are converted at a time
    buffer = io.BytesIO()
    Image.fromarray(levels).save(buffer, "PNG")
    photo = decode_image(buffer.getvalue(), index=0)
    np.testing.assert_array_equal(photo.rgb, np.rint(levels / 257.0).astype(np.uint8)[:, :, None].repeat(3, axis=2))


def test_large_images_are_opened_without_a_warning_and_the_filters_stay():
    buffer = io.BytesIO()
    Image.new("1", (10_000, 9_000)).save(buffer, "PNG")  # above the size from which Pillow warns
    before = list(warnings.filters)
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        assert open_image(buffer.getvalue(), index=0, max_pixels=10**9).size == (10_000, 9_000)
    assert heard == []
    assert warnings.filters == before


@pytest.mark.parametrize("kind", ["PNG", "WEBP"])
def test_entries_of_exif_that_share_their_bytes_are_not_copied_one_by_one(kind):
    """2,000 entries, each of the same 26 kB: 52 MB in Pillow before 13, and of 250 kB gigabytes."""
    entries = b"".join(struct.pack("<HHII", tag, 7, 26_000, 8) for tag in range(1, 2001))
    exif = b"II*\0" + struct.pack("<IH", 8, 2000) + entries + bytes(2004)
    data = encoded(kind, exif=exif)
    tracemalloc.start()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert decode_image(data, index=0).orientation == 1
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5_000_000
