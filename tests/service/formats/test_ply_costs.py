"""A .ply costs no more time and memory than its bytes are worth, whatever its header says."""

import tracemalloc

import pytest
from ply_cases import assert_same, gaussians

from gapmes.service.errors import PlyError
from gapmes.service.formats import ply_format
from gapmes.service.formats.ply import ply_bytes, read_ply
from gapmes.service.formats.ply_read import REQUIRED

OURS = ply_bytes(gaussians(6, 1, 1))


def test_numbers_beside_a_list_are_passed_over_at_once(monkeypatch):
    """A byte each: one by one, those of a file of 128 MiB take most of a minute."""
    start, body = OURS.index(b"element vertex"), OURS.index(b"end_header\n") + 11
    numbers = [b"property uchar a%d\n" % place for place in range(600)]
    head = b"element junk 3\n" + b"".join([*numbers[:300], b"property list uchar short l\n", *numbers[300:]])
    rows = b"".join(bytes(300) + bytes([length]) + bytes(2 * length) + bytes(300) for length in (0, 7, 2))
    checks, check = [], ply_format._require_bytes
    monkeypatch.setattr(ply_format, "_require_bytes", lambda *given: (checks.append(1), check(*given)))
    assert_same(read_ply(OURS[:start] + head + OURS[start:body] + rows + OURS[body:]), read_ply(OURS))
    assert len(checks) == 9
    for cut in (2, 301, 303, 700, len(rows) - 1):
        with pytest.raises(PlyError, match=r"row \d of 3 needs \d+ bytes at \d+, the file has"):
            read_ply(OURS[:start] + head + OURS[start:body] + rows[:cut])


def test_rows_that_are_too_short_take_no_memory_for_all():
    """45 GB for 4 MB of text, where a row has thousands of numbers by the header."""
    names = [*REQUIRED, *(f"a{place}" for place in range(1000))]
    head = "ply\nformat ascii 1.0\nelement vertex 200000\n" + "".join(f"property float {name}\n" for name in names)
    file = f"{head}end_header\n{'0 ' * len(names)}\n".encode() + b"0\n" * 199_999
    tracemalloc.start()
    with pytest.raises(PlyError, match=r"row 1 has 1 numbers, need 10\d\d") as refusal:
        read_ply(file)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert refusal.value.index == 1
    assert peak < 50_000_000
