"""The comparison sheet of the demonstration."""

from __future__ import annotations

import numpy as np

from gapmes.service.contact_sheet import Cell, Row, contact_sheet


def test_comparison_holds_every_picture() -> None:
    colours = [(200, 0, 0), (0, 200, 0), (0, 0, 200)]
    cells = [Cell(np.full((256, 256, 3), colour, np.uint8), "label") for colour in colours]
    sheet = np.asarray(contact_sheet([Row("One", cells[:1]), Row("Two", cells[1:])]))
    for colour in colours:
        assert (sheet == colour).all(axis=2).sum() == 256 * 256
