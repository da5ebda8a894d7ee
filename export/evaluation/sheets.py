"""A contact sheet per scene: the inputs, then per target truth, model, best baseline and absolute error."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gapmes.service.pictures.contact_sheet import CELL, Cell, Row, contact_sheet
from gapmes.service.pictures.picture_error import psnr

from .case import Case
from .measure import Measured

F32 = NDArray[np.float32]

ERROR_GAIN = 3  # factor on absolute errors, most of which would be too dark to see


def scene_sheet(case: Case, measured: Measured, model: str) -> Image.Image:
    """Rows of labelled pictures with their PSNR over all pixels; in the error, pixels that no input sees are blue."""
    best = measured.score.best_baseline
    numbers = case.numbers or range(len(case.inputs))
    named = zip(case.inputs, numbers, strict=True)
    rows = [Row(f"{case.name}: inputs", [_cell(_eight_bit(v.image), f"input, view {i}") for v, i in named])]
    for index, (target, mask) in enumerate(zip(case.targets, measured.masks, strict=True)):
        truth = _eight_bit(target.image)
        ours, theirs = (_eight_bit(measured.pictures[name][index]) for name in (model, best))
        error = ERROR_GAIN * np.abs(ours.astype(np.int16) - truth).clip(0, 255 // ERROR_GAIN)
        error[~mask, 2] = 255
        cells = [
            _cell(truth, "truth"),
            _cell(ours, f"{model}  {psnr(ours, truth):.2f} dB"),
            _cell(theirs, f"{best}  {psnr(theirs, truth):.2f} dB"),
            _cell(error.astype(np.uint8), f"error of {model} x {ERROR_GAIN}; blue: not seen"),
        ]
        rows.append(Row(f"target {index}", cells))
    return contact_sheet(rows)


def _cell(pixels: NDArray[np.uint8], label: str) -> Cell:
    """A labelled picture; a small one is enlarged by an integer factor, without interpolation."""
    factor = max(1, CELL // max(pixels.shape[:2]))
    return Cell(pixels.repeat(factor, axis=0).repeat(factor, axis=1), label)


def _eight_bit(picture: F32) -> NDArray[np.uint8]:
    """(H, W, 3) from (3, H, W), clipped to [0, 1] and rounded to 8 bits."""
    return np.rint(np.clip(picture, 0, 1).transpose(1, 2, 0) * 255).astype(np.uint8)
