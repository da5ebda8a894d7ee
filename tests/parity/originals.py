"""The publishers' own torch code, imported from a checkout that an environment variable names."""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
import types
import warnings
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor, nn


def checkout(variable: str, marker: str) -> Path:
    """The folder that `variable` names; if it is not set, the test is skipped with a message that names it."""
    value = os.environ.get(variable)
    if not value:
        message = f"NOT COMPARED with the original code: set {variable} to a checkout that holds {marker}"
        warnings.warn(message, stacklevel=2)  # which the summary shows, unlike the reason of a skip
        pytest.skip(message)
    root = Path(value)
    assert (root / marker).is_file(), f"{variable}={value} holds no {marker}"
    return root


def import_from(root: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Import a module of the checkout, without the libraries that it needs only to read pictures."""
    libraries = ("cv2", "torchvision", "torchvision.transforms")
    for absent in [x for x in libraries if importlib.util.find_spec(x.partition(".")[0]) is None]:
        stub = types.ModuleType(absent)
        vars(stub).update(Compose=object, INTER_CUBIC=0, INTER_AREA=0)
        monkeypatch.setitem(sys.modules, absent, stub)
    monkeypatch.setenv("XFORMERS_DISABLED", "1")
    monkeypatch.syspath_prepend(str(root))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return importlib.import_module(name)


def randomise(module: nn.Module, seed: int) -> None:
    """Variance in every layer, and depths that are not constant."""
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for name, p in module.named_parameters():
            if p.ndim == 4:
                p.normal_(0, (2 / p[0].numel()) ** 0.5, generator=generator)
            elif p.ndim == 2:
                p.normal_(0, p.shape[1] ** -0.5, generator=generator)
            elif "norm" in name and name.endswith("weight"):
                p.uniform_(0.5, 1.5, generator=generator)
            elif name.endswith("gamma"):
                p.uniform_(0.1, 0.5, generator=generator)
            else:
                p.normal_(0, 0.3, generator=generator)


def relative(a: Tensor, b: Tensor) -> float:
    """The largest difference, relative to the spread of `b`."""
    return float((a - b).abs().max() / b.std())
