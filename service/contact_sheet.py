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


def contact_sheet(rows: Sequence[Row]) -> Image.Image:
    """Draw the rows below each other; pictures keep their aspect and are scaled to `CELL` where they are larger."""
    columns = max(len(row.cells) for row in rows)
    height = sum(TITLE + CELL + LABEL + GAP for _ in rows) + GAP
    sheet = Image.new("RGB", (columns * (CELL + GAP) + GAP, height), PAPER)
    draw = ImageDraw.Draw(sheet)
    title_font, label_font = ImageFont.load_default(18), ImageFont.load_default(14)
    top = GAP
    for row in rows:
        draw.text((GAP, top), row.title, INK, title_font)
        for column, cell in enumerate(row.cells):
            left = GAP + column * (CELL + GAP)
            picture = Image.fromarray(cell.pixels)
            picture.thumbnail((CELL, CELL), Image.Resampling.LANCZOS)
            sheet.paste(picture, (left, top + TITLE))
            draw.text((left, top + TITLE + picture.height + 3), cell.label, INK, label_font)
        top += TITLE + CELL + LABEL + GAP
    return sheet
