"""The comparison sheet of the demonstration, and its score."""

from __future__ import annotations

import numpy as np
import pytest

from gapmes.service.contact_sheet import Cell, Row, contact_sheet, psnr


def test_comparison_holds_every_picture() -> None:
    colours = [(200, 0, 0), (0, 200, 0), (0, 0, 200)]
    cells = [Cell(np.full((256, 256, 3), colour, np.uint8), "label") for colour in colours]
    sheet = np.asarray(contact_sheet([Row("One", cells[:1]), Row("Two", cells[1:])]))
    for colour in colours:
        assert (sheet == colour).all(axis=2).sum() == 256 * 256


def test_psnr_is_the_formula() -> None:
    a = np.zeros((4, 4, 3), np.uint8)
    assert psnr(a, a) == float("inf")
    assert psnr(a, a + 255) == pytest.approx(0.0)
    assert psnr(a, a + 51) == pytest.approx(-20 * np.log10(0.2))
