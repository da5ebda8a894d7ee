"""Rows behind those that a header declares are reported, and nothing else behind them is."""

from __future__ import annotations

from ply_cases import columns
from test_ply_dialects import scene

from gapmes.service.formats.ply import inspect_ply, ply_bytes
from gapmes.service.formats.registry import FORMATS, inspect_gaussians

LINES = 10_000  # behind the declared rows of a text, which are looked at


def test_rows_behind_the_declared_ones_are_said() -> None:
    """Another count in the header hides Gaussians."""
    data = ply_bytes(scene(1000))
    reading = inspect_ply(data.replace(b"element vertex 1000", b"element vertex 900"))
    assert len(reading.gaussians) == 900
    assert reading.notes()[-1].startswith("of 1000 rows 100 lie behind those that the header declares")
    names = list(columns(data))
    header = "".join(f"property float {name}\n" for name in names)
    lines = "\n".join(" ".join(["0"] * (len(names) - 4) + ["1", "0", "0", "0"]) for _ in range(5))
    text = f"ply\nformat ascii 1.0\nelement vertex 3\n{header}end_header\n{lines}\n\n\x1a"
    assert any("of 5 rows 2 lie behind" in note for note in inspect_ply(text.encode()).notes())
    nothing = text.replace("element vertex", "element nothing 9\nelement vertex")  # of no properties, and of no lines
    assert any("of 5 rows 2 lie behind" in note for note in inspect_ply(nothing.encode()).notes())
    packed = FORMATS["compressed.ply"].write(scene(10)).data
    for more in (1, 2):
        notes = inspect_gaussians(packed + bytes(more * 16))[0].notes()
        assert any(f"of {10 + more} rows {more} lie behind" in note for note in notes)
    faces = b"element face 0\nproperty list uchar int vertex_indices\nend_header"
    short = data.replace(b"element vertex 1000", b"element vertex 900").replace(b"end_header", faces)
    assert any("of 1000 rows 100 lie" in note for note in inspect_ply(short).notes())


def test_of_endless_lines_behind_the_rows_some_are_looked_at() -> None:
    """Each is split into words, which would take minutes for 100 MB of short ones."""
    names = list(columns(ply_bytes(scene(1))))
    header = "".join(f"property float {name}\n" for name in names)
    row = " ".join(["0"] * (len(names) - 4) + ["1", "0", "0", "0"]) + "\n"
    text = f"ply\nformat ascii 1.0\nelement vertex 1\n{header}end_header\n{row}"
    notes = inspect_ply((text + row * 5 + "0\n" * (LINES - 5)).encode()).notes()
    assert any("of 6 rows 5 lie behind" in note for note in notes)
    notes = inspect_ply((text + row * 5 + "0\n" * (LINES - 4)).encode()).notes()
    assert any(note.startswith("5 rows or more lie behind the 1 that the header declares") for note in notes)
    assert not any("lie behind" in note for note in inspect_ply((text + "0\n" * (LINES + 1)).encode()).notes())
    faces = text.replace("end_header", "element face 1000001\nproperty list uchar int vertex_indices\nend_header")
    many = faces + "3 0 0 0\n" * 1_000_001 + row
    assert not any("lie behind" in note for note in inspect_ply(many.encode()).notes())  # they would be walked past
    few = many.replace("face 1000001", "face 1000000").replace("3 0 0 0\n", "", 1)
    assert any("of 2 rows 1 lie behind" in note for note in inspect_ply(few.encode()).notes())


def test_what_is_no_row_behind_the_rows_is_nothing() -> None:
    """Line ends, zeros, lists, a last element that is short and that nobody reads, and a line of a million blanks."""
    data = ply_bytes(scene(100))
    extra = data.replace(b"end_header", b"element extra 999999999999\nproperty float a\nend_header")
    faces = data.replace(b"end_header", b"element face 9\nproperty list uchar int vertex_indices\nend_header")
    names = list(columns(data))
    header = "".join(f"property float {name}\n" for name in names)
    line = " ".join(["0"] * (len(names) - 4) + ["1", "0", "0", "0"])
    blank = f"ply\nformat ascii 1.0\nelement vertex 1\n{header}end_header\n{line}\n{' ' * 1_000_000}\n".encode()
    for file in (data + b"\n", data + bytes(3), extra, faces, faces + 9 * (b"\3" + bytes(12)), blank):
        assert not any("lie behind" in note for note in inspect_ply(file).notes())
