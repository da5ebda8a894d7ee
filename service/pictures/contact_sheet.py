"""Contact sheets: labelled rows of images in one picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

CELL = 256  # px, the longer side of a picture
GAP = 12  # px
TITLE, LABEL = 30, 22  # px, heights of a row's title and of a picture's label
COLUMNS = 6
INK, PAPER = (30, 30, 30), (255, 255, 255)

T = TypeVar("T")
Size = tuple[int, int]  # width and height in px


@dataclass(frozen=True)
class Cell:
    """An image and the label under it."""

    pixels: NDArray[np.uint8]  # (H, W, 3)
    label: str


@dataclass(frozen=True)
class Row:
    title: str
    cells: Sequence[Cell]


def in_rows(things: Sequence[T], columns: int = COLUMNS) -> list[Sequence[T]]:
    """Split a sequence into rows of at most `columns`."""
    return [things[start : start + columns] for start in range(0, len(things), columns)]


def rows_of(title: str, cells: Sequence[Cell], columns: int = COLUMNS) -> list[Row]:
    """Rows of at most `columns` cells, with the title over the first."""
    return [Row(title if number == 0 else "", row) for number, row in enumerate(in_rows(cells, columns))]


def sheet_size(rows: Sequence[Sequence[Size]]) -> Size:
    """Size in px of a sheet with rows of pictures of these sizes, of which no side exceeds `CELL`."""
    return max(map(len, rows)) * (CELL + GAP) + GAP, sum(map(_height, rows)) + GAP


def contact_sheet(rows: Sequence[Row]) -> Image.Image:
    """Draw the sheet; pictures larger than `CELL` are scaled down, keeping their aspect."""
    pictures = [[_scaled(cell.pixels) for cell in row.cells] for row in rows]
    sizes = [[picture.size for picture in row] for row in pictures]
    sheet = Image.new("RGB", sheet_size(sizes), PAPER)
    draw = ImageDraw.Draw(sheet)
    title_font, label_font = ImageFont.load_default(18), ImageFont.load_default(14)
    top = GAP
    for row, scaled, sides in zip(rows, pictures, sizes, strict=True):
        draw.text((GAP, top), row.title, INK, title_font)
        for column, (cell, picture) in enumerate(zip(row.cells, scaled, strict=True)):
            left = GAP + column * (CELL + GAP)
            sheet.paste(picture, (left, top + TITLE))
            draw.text((left, top + TITLE + picture.height + 3), cell.label, INK, label_font)
        top += _height(sides)
    return sheet


def _height(row: Sequence[Size]) -> int:
    return TITLE + max(height for _, height in row) + LABEL + GAP


def _scaled(pixels: NDArray[np.uint8]) -> Image.Image:
    picture = Image.fromarray(pixels)
    picture.thumbnail((CELL, CELL), Image.Resampling.LANCZOS)
    return picture
