"""Shared options of commands that read files of Gaussians: format, dialect, and dropping of invalid rows."""

from __future__ import annotations

from typing import Annotated, Literal

import typer

SourceFormatOption = Annotated[
    str | None,
    typer.Option("--from", help="format of the file, if neither its bytes nor its extension tell"),
]
OpacityOption = Annotated[
    Literal["auto", "logit", "linear"], typer.Option("--opacity", help="what a .ply holds: logits, or opacities")
]
ScalesOption = Annotated[
    Literal["auto", "log", "linear"], typer.Option("--scales", help="what a .ply holds: logarithms, or sizes")
]
RotationOption = Annotated[
    Literal["auto", "wxyz", "xyzw"], typer.Option("--rotation", help="order of a .ply's quaternions [auto: wxyz]")
]
AxesOption = Annotated[
    Literal["rub", "rdf"],
    typer.Option("--axes", help="axes of a .spz: right-up-back, or right-down-front as in a .ply"),
]
DropInvalidOption = Annotated[
    bool,
    typer.Option("--drop-invalid", help="leave out and count Gaussians that cannot be read: NaN, beyond float32"),
]
