"""One picture of labelled rows of images: inputs, truth and renders side by side, each with its PSNR."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

CELL = 256  # px, the longer side of a picture
GAP = 12  # px
TITLE, LABEL = 30, 22  # px, heights of a row's title and of a picture's label
INK, PAPER = (30, 30, 30), (255, 255, 255)


@dataclass(frozen=True)
class Cell:
    """A picture with the text under it."""

    pixels: NDArray[np.uint8]  # (H, W, 3)
    label: str


@dataclass(frozen=True)
class Row:
    title: str
    cells: Sequence[Cell]


def rows_of(title: str, cells: Sequence[Cell], columns: int = 6) -> list[Row]:
    """As many rows as the cells need, the title over the first."""
    starts = range(0, len(cells), columns)
    return [Row(title if start == 0 else "", cells[start : start + columns]) for start in starts]


def contact_sheet(rows: Sequence[Row]) -> Image.Image:
    """Draw the rows below each other; pictures keep their aspect and are scaled to `CELL` where they are larger."""
    pictures = [[_scaled(cell.pixels) for cell in row.cells] for row in rows]
    columns = max(len(row.cells) for row in rows)
    heights = [TITLE + max(picture.height for picture in row) + LABEL + GAP for row in pictures]
    sheet = Image.new("RGB", (columns * (CELL + GAP) + GAP, sum(heights) + GAP), PAPER)
    draw = ImageDraw.Draw(sheet)
    title_font, label_font = ImageFont.load_default(18), ImageFont.load_default(14)
    top = GAP
    for row, scaled, height in zip(rows, pictures, heights, strict=True):
        draw.text((GAP, top), row.title, INK, title_font)
        for column, (cell, picture) in enumerate(zip(row.cells, scaled, strict=True)):
            left = GAP + column * (CELL + GAP)
            sheet.paste(picture, (left, top + TITLE))
            draw.text((left, top + TITLE + picture.height + 3), cell.label, INK, label_font)
        top += height
    return sheet


def _scaled(pixels: NDArray[np.uint8]) -> Image.Image:
    picture = Image.fromarray(pixels)
    picture.thumbnail((CELL, CELL), Image.Resampling.LANCZOS)
    return picture
