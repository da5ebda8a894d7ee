"""What is kept of a request until its job is computed: where it is lost or damaged, the job says so."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from job_place import Place

LOST = "were deleted from the store before they were computed"
DAMAGED = "cannot be read, as after a power cut"


def changed(folder: Path, **members: Any) -> None:
    document = json.loads((folder / "work.json").read_bytes())
    (folder / "work.json").write_text(json.dumps(document | members))


@pytest.mark.parametrize(
    ("lose", "told"),
    [
        (shutil.rmtree, LOST),
        (lambda folder: (folder / "1").unlink(), LOST),
        (lambda folder: (folder / "work.json").write_bytes(b""), DAMAGED),
        (lambda folder: (folder / "work.json").write_bytes(bytes(300)), DAMAGED),
        (lambda folder: (folder / "work.json").write_bytes(b"{}"), DAMAGED),
        (lambda folder: (folder / "work.json").write_bytes(b"[]"), DAMAGED),
        (lambda folder: (folder / "1").write_bytes(b""), DAMAGED),
        (lambda folder: (folder / "0").write_bytes(bytes(3)), DAMAGED),
        (lambda folder: (folder / "sha256").write_bytes(b""), DAMAGED),
        (lambda folder: changed(folder, cameras=[{}, {}]), DAMAGED),
        (lambda folder: changed(folder, budget=None), DAMAGED),
    ],
)
def test_it_is_asked_for_again(
    place: Place, caplog: pytest.LogCaptureFixture, lose: Callable[[Path], object], told: str
) -> None:
    place.submit()
    lose(place.root / "jobs" / "1")
    place.runner(lambda *_: pytest.fail("computed"))
    job = place.ended()
    assert job.state == "failed"
    assert job.problem is not None
    assert (job.problem["status"], job.problem["code"]) == (410, "inputs_gone")
    assert told in job.problem["detail"]
    assert job.problem["cure"] == "ask for it again"
    assert "Traceback" not in caplog.text


def test_photographs_that_an_earlier_release_kept_are_computed(place: Place) -> None:
    """It wrote no digest of them."""
    place.submit()
    (place.root / "jobs" / "1" / "sha256").unlink()
    place.runner(lambda *_: None)
    assert place.ended().state == "done"
