"""The package as a notebook meets it: names that complete, and values that are short when a cell ends with them."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import fields

from clouds import cloud

import gapmes.service
from gapmes.service import EncodedPhoto, Gaussians
from gapmes.service.formats.encoded import Encoded


def test_public_names_are_listed_before_they_are_used() -> None:
    code = "import sys, gapmes.service as s; assert set(s.__all__) <= set(dir(s)); assert 'numba' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
    assert all(hasattr(gapmes.service, name) for name in gapmes.service.__all__)


def test_files_in_memory_are_not_spelled_out() -> None:
    data = bytes(10_000)
    assert repr(Encoded(data, ("a note",))) == "Encoded(notes=('a note',))"
    assert len(repr(EncodedPhoto(data))) < 100


def test_gaussians_are_counted_and_help_says_what_their_arrays_hold() -> None:
    gaussians = cloud(2000, seed=1, degree=1)
    assert repr(gaussians) == "<2000 Gaussians of SH degree 1>"
    assert all(f"`{field.name}`: (N," in (Gaussians.__doc__ or "") for field in fields(Gaussians))
