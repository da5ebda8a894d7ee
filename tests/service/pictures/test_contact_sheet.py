"""Sheets of labelled pictures: the demonstration's comparison, and all views of a scene."""

from __future__ import annotations

import numpy as np

from gapmes.service.pictures.contact_sheet import (
    CELL,
    GAP,
    LABEL,
    TITLE,
    Cell,
    Row,
    contact_sheet,
    in_rows,
    rows_of,
    sheet_size,
)


def test_comparison_holds_every_picture() -> None:
    colours = [(200, 0, 0), (0, 200, 0), (0, 0, 200)]
    cells = [Cell(np.full((256, 256, 3), colour, np.uint8), "label") for colour in colours]
    sheet = np.asarray(contact_sheet([Row("One", cells[:1]), Row("Two", cells[1:])]))
    for colour in colours:
        assert (sheet == colour).all(axis=2).sum() == 256 * 256


def test_the_size_of_a_sheet_is_known_before_it_is_drawn() -> None:
    sides = [(160, 90), (90, 160), (256, 256), (1, 256), (7, 3)]
    cells = [Cell(np.zeros((height, width, 3), np.uint8), "") for width, height in sides]
    for columns in (1, 2, 3, 6):
        sheet = contact_sheet(rows_of("Views", cells, columns))
        assert sheet_size(in_rows(sides, columns)) == sheet.size


def test_many_cells_go_into_several_rows_as_high_as_their_pictures() -> None:
    cells = [Cell(np.full((90, 160, 3), 10 + index, np.uint8), str(index)) for index in range(8)]
    rows = rows_of("Views", cells, columns=3)
    assert [(row.title, len(row.cells)) for row in rows] == [("Views", 3), ("", 3), ("", 2)]
    sheet = np.asarray(contact_sheet(rows))
    assert sheet.shape == (3 * (TITLE + 90 + LABEL + GAP) + GAP, 3 * (CELL + GAP) + GAP, 3)
    for index in range(8):
        assert (sheet == 10 + index).all(axis=2).sum() >= 90 * 160  # text has greys of its own


def test_titles_stand_above_their_row_and_labels_below_their_picture() -> None:
    cells = [Cell(np.full((height, 160, 3), 255, np.uint8), "") for height in (90, 60)]
    plain = np.asarray(contact_sheet([Row("", cells)]))
    titled = np.asarray(contact_sheet([Row("Title", cells)]))
    labelled = np.asarray(contact_sheet([Row("", [cells[0], Cell(cells[1].pixels, "label")])]))
    assert plain.shape == (TITLE + 90 + LABEL + 2 * GAP, 2 * CELL + 3 * GAP, 3)
    assert (plain == 255).all()
    rows, columns = np.nonzero((titled < 128).all(axis=2))
    assert GAP <= rows.min() < rows.max() < GAP + TITLE
    assert GAP <= columns.min() < GAP + 5
    rows, columns = np.nonzero((labelled < 128).all(axis=2))
    assert GAP + TITLE + 60 <= rows.min() < rows.max() < GAP + TITLE + 60 + LABEL
    assert 2 * GAP + CELL <= columns.min() < 2 * GAP + CELL + 5


def test_a_larger_picture_is_scaled_to_its_cell() -> None:
    sheet = np.asarray(contact_sheet([Row("", [Cell(np.full((300, 512, 3), 40, np.uint8), "")])]))
    assert sheet.shape == (TITLE + 150 + LABEL + 2 * GAP, CELL + 2 * GAP, 3)
    assert (sheet[GAP + TITLE : GAP + TITLE + 150, GAP : GAP + CELL] == 40).all()
    assert (sheet == 40).all(axis=2).sum() == 150 * CELL


def test_a_row_is_as_high_as_its_highest_picture_wherever_that_stands() -> None:
    cells = [Cell(np.full((height, 160, 3), 40, np.uint8), "") for height in (60, 90, 30)]
    rows = [Row("", cells), Row("", cells[:1])]
    sheet = np.asarray(contact_sheet(rows))
    assert sheet.shape[0] == 2 * (TITLE + LABEL + GAP) + 90 + 60 + GAP
    below = GAP + TITLE + 90 + LABEL + GAP + TITLE
    assert (sheet[below : below + 60, GAP : GAP + 160] == 40).all()
    assert (sheet == 40).all(axis=2).sum() == 160 * (60 + 90 + 30 + 60)
