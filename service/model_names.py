"""The names of the configured models: the default one and those of GAPMES_MODELS, each with its file."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from .errors import InputError, ModelUnknown
from .process.home import at_home
from .shipped import shipped_model

DEFAULT = "default"
VARIABLE = "GAPMES_MODELS"
_NAME = re.compile(r"[a-z0-9][a-z0-9_.-]{0,39}")


def model_paths(model: Path | None, further: str) -> dict[str, Path]:
    """Name -> file: the default one first, then `further`, such as `base=/models/base.onnx,small=/models/small.onnx`.

    Raises `InputError` for an entry of another form, and for a name that is none or is given twice.
    """
    paths = {DEFAULT: shipped_model() if model is None else model}
    entries = [entry.strip() for entry in further.split(",")] if further.strip() else []
    for index, entry in enumerate(entries):
        name, _, path = (part.strip() for part in entry.partition("="))
        if not path:
            raise InputError(
                f"{entry[:100]!r} is no model", field=VARIABLE, index=index, cure="write name=/models/file.onnx"
            )
        if not _NAME.fullmatch(name):
            raise InputError(
                f"{name[:100]!r} is no name", field=VARIABLE, index=index,
                cure="up to 40 of a-z, 0-9, _ . -, a letter or a digit first",
            )  # fmt: skip
        if name in paths:
            cure = "the default one is GAPMES_MODEL" if name == DEFAULT else "give each name once"
            raise InputError(f"the name {name!r} is taken", field=VARIABLE, index=index, cure=cure)
        try:
            paths[name] = at_home(Path(path))
        except ValueError as error:
            raise InputError(str(error), field=VARIABLE, index=index, cure="write the whole path") from error
    return paths


def checked_name(name: str, names: Iterable[str]) -> str:
    """Raises `ModelUnknown` where it is none of `names`."""
    known = list(names)
    if name not in known:
        raise ModelUnknown(
            f"{name[:50]!r} is no model of this service", field="model", cure=f"there is {', '.join(known)}"
        )
    return name
