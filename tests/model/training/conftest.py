"""Settings for the tests of training: runs are validated on little pictures."""

from __future__ import annotations

import pytest

from gapmes.model.training import loop


@pytest.fixture(autouse=True)
def _little_validation(monkeypatch: pytest.MonkeyPatch) -> None:
    """At a quarter of the area: at 128 px it took as long as the one step of a run. Processes that a test starts keep
    the usual size."""
    monkeypatch.setattr(loop, "VALIDATION_SIZE", 64)
